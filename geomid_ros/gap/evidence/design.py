"""All columns that compete for the explanation of each channel, whitened, and kept as products of columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate, EffectTerm, Term
from geomid_ros.gap.evidence.noise import Autoregression, runs_of
from geomid_ros.gap.evidence.record import Records
from geomid_ros.model.effects import MotionEffect, SensorEffect, Situation, SituationEffect
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray, IntArray

Columns = Mapping[Term, Mapping[int, FloatArray]]  # of each term, by channel: (N,)


def term_columns(
    model: MeasurementModel, records: Records, terms: Sequence[Term], situation: Callable[[], Situation]
) -> dict[Term, dict[int, FloatArray]]:
    """Columns of effects' terms at the chosen rows, by the channels that they reach; ``situation``, which takes
    long, is asked for only when a term needs it."""
    found: dict[Term, dict[int, FloatArray]] = {}
    for term in terms:
        if isinstance(term, EffectTerm) and isinstance(term.effect, SituationEffect):
            columns = term.effect.columns(situation(), term.place)[:, :, term.index]
            found[term] = {channel: column for channel, column in enumerate(columns.T) if np.any(column)}
        elif isinstance(term, EffectTerm) and isinstance(term.effect, MotionEffect | SensorEffect):
            found[term] = model.columns_of(records.samples, term.effect, term.place, term.index)
    return found


BLOCKS = 8  # of time, for cross-validation


@dataclass(frozen=True, eq=False)
class ChannelProducts:
    """Products ``(K + 1, K + 1)`` of a channel's K whitened columns and of its target (the last but for a zero row for
    what does not reach the channel), and those of each block of time; ``place`` of each term, ``count`` of rows."""

    products: FloatArray
    blocks: FloatArray
    place: Mapping[Term, int]
    count: int


@dataclass(frozen=True, eq=False)
class CandidateProducts:
    """Products of the k columns of each of G candidates: ``crossed`` with the n columns of a fit and its target
    ``(G, C, k, n + 1)``, ``squared`` with each other ``(G, C, k, k)``; zero where a column does not reach a channel."""

    crossed: FloatArray
    squared: FloatArray


@dataclass(frozen=True, eq=False)
class Design:
    """Products of all channels, for ``dimension`` inertial columns."""

    channels: tuple[ChannelProducts, ...]
    dimension: int
    _known_places: dict[AnyCandidate, IntArray] = field(default_factory=dict, init=False, repr=False)
    _known_terms: dict[Term, IntArray] = field(default_factory=dict, init=False, repr=False)

    @staticmethod
    def make(
        coefficients: FloatArray,
        targets: FloatArray,
        valid: BoolArray,
        columns: Columns,
        noise: Sequence[Autoregression],
        records: Records,
    ) -> Design:
        """From rows ``(N, C, D)``, targets ``(N, C)``, which of them are ``valid``, columns and the channels' noise."""
        channels = []
        for channel in range(targets.shape[1]):
            terms = [term for term, by_channel in columns.items() if channel in by_channel]
            own = [columns[term][channel] for term in terms]
            stacked = np.column_stack([coefficients[:, channel], *own, targets[:, channel]])
            runs = runs_of(valid[:, channel], records.segment)
            white = noise[channel].whiten(stacked, runs)
            blocks = np.array([np.pad(part.T @ part, ((0, 1), (0, 1))) for part in np.array_split(white, BLOCKS)])
            place = {term: coefficients.shape[2] + index for index, term in enumerate(terms)}
            channels.append(ChannelProducts(np.sum(blocks, axis=0), blocks, place, len(white)))
        return Design(tuple(channels), coefficients.shape[2])

    @property
    def counts(self) -> FloatArray:
        """Rows of each channel."""
        return np.array([float(channel.count) for channel in self.channels])

    @property
    def target_squares(self) -> FloatArray:
        """Sum of squares of each channel's target."""
        return np.array([channel.products[-2, -2] for channel in self.channels])

    def gather(self, bodies: Sequence[int], terms: Sequence[Term]) -> FloatArray:
        """Products ``(C, n, n)`` of the inertial columns, once more those of each link of ``bodies``, the terms'
        and the target's."""
        places = self._places(bodies, terms)
        return np.array([_taken(c.products, own, own) for c, own in zip(self.channels, places, strict=True)])

    def gather_blocks(self, bodies: Sequence[int], terms: Sequence[Term]) -> FloatArray:
        """The same for each block of time ``(C, blocks, n, n)``."""
        places = self._places(bodies, terms)
        return np.array([c.blocks[:, own][:, :, own] for c, own in zip(self.channels, places, strict=True)])

    def _places(self, bodies: Sequence[int], terms: Sequence[Term]) -> IntArray:
        """In each channel ``(C, n)``, of the inertial columns, those of each link of ``bodies``, the terms' and the
        target's."""
        again = [10 * body + k for body in bodies for k in range(10)]
        inertial = np.tile([*range(self.dimension), *again], (len(self.channels), 1))
        own = [self._places_of_term(term) for term in terms]
        return np.column_stack([inertial, *own, np.full(len(self.channels), -2)])

    def _places_of_term(self, term: Term) -> IntArray:
        """In each channel ``(C,)``; that of the zero row where it is absent."""
        if term not in self._known_terms:
            self._known_terms[term] = np.array([channel.place.get(term, -1) for channel in self.channels])
        return self._known_terms[term]

    def reached(self, candidate: AnyCandidate) -> list[int]:
        """The channels that a candidate can change."""
        if candidate.payload is not None:
            return list(range(len(self.channels)))
        return [i for i, c in enumerate(self.channels) if any(term in c.place for term in candidate.terms)]

    def own(self, alike: Sequence[AnyCandidate], bodies: Sequence[int], terms: Sequence[Term]) -> CandidateProducts:
        """Products of the columns of candidates, each of which has as many, with those of :meth:`gather`."""
        crossed, squared = [], []
        every = np.array([self._own_places(candidate) for candidate in alike])
        for mine, others, channel in zip(every.swapaxes(0, 1), self._places(bodies, terms), self.channels, strict=True):
            crossed.append(_taken(channel.products, mine, others))
            squared.append(_taken(channel.products, mine, mine))
        return CandidateProducts(np.stack(crossed, axis=1), np.stack(squared, axis=1))

    def _own_places(self, candidate: AnyCandidate) -> IntArray:
        """Places of a candidate's columns in each channel ``(C, k)``."""
        if candidate not in self._known_places:
            body = candidate.payload
            carried = None if body is None else np.tile(np.arange(10 * body, 10 * body + 10), (len(self.channels), 1))
            own = [self._places_of_term(term) for term in candidate.terms]
            self._known_places[candidate] = np.column_stack(own) if carried is None else carried
        return self._known_places[candidate]


def _taken(matrix: FloatArray, rows: IntArray, columns: IntArray) -> FloatArray:
    """The entries ``(..., r, c)`` of a square matrix at rows ``(..., r)`` and columns ``(..., c)``, of which some count
    from the end: several times faster than by two indices."""
    size = len(matrix)
    flat = (rows % size)[..., :, None] * size + (columns % size)[..., None, :]
    return np.take(matrix, flat, mode="clip")
