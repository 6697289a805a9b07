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

    def gather(self, terms: Sequence[Term]) -> list[int]:
        """Places of terms; those that are absent stand at the zero row."""
        return [self.place.get(term, -1) for term in terms]


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
        indices = [self._places(channel, bodies, terms) for channel in self.channels]
        return np.array([c.products[np.ix_(index, index)] for c, index in zip(self.channels, indices, strict=True)])

    def gather_blocks(self, bodies: Sequence[int], terms: Sequence[Term]) -> FloatArray:
        """The same for each block of time ``(C, blocks, n, n)``."""
        indices = [self._places(channel, bodies, terms) for channel in self.channels]
        return np.array([c.blocks[:, index][:, :, index] for c, index in zip(self.channels, indices, strict=True)])

    def _places(self, channel: ChannelProducts, bodies: Sequence[int], terms: Sequence[Term]) -> list[int]:
        again = [10 * body + k for body in bodies for k in range(10)]
        return [*range(self.dimension), *again, *channel.gather(terms), -2]

    def reached(self, candidate: AnyCandidate) -> list[int]:
        """The channels that a candidate can change."""
        if candidate.payload is not None:
            return list(range(len(self.channels)))
        return [i for i, c in enumerate(self.channels) if any(term in c.place for term in candidate.terms)]

    def own(self, alike: Sequence[AnyCandidate], bodies: Sequence[int], terms: Sequence[Term]) -> CandidateProducts:
        """Products of the columns of candidates, each of which has as many, with those of :meth:`gather`."""
        crossed, squared = [], []
        every = np.array([self._own_places(candidate) for candidate in alike])
        for index, channel in enumerate(self.channels):
            mine, others = every[:, index], np.array(self._places(channel, bodies, terms))
            crossed.append(channel.products[mine[:, :, None], others])
            squared.append(channel.products[mine[:, :, None], mine[:, None, :]])
        return CandidateProducts(np.stack(crossed, axis=1), np.stack(squared, axis=1))

    def _own_places(self, candidate: AnyCandidate) -> IntArray:
        """Places of a candidate's columns in each channel ``(C, k)``."""
        if candidate not in self._known_places:
            body = candidate.payload
            carried = None if body is None else list(range(10 * body, 10 * body + 10))
            self._known_places[candidate] = np.array([carried or c.gather(candidate.terms) for c in self.channels])
        return self._known_places[candidate]
