"""Bounded memory of any number of rows: their least-squares content, kept by QR.

Factors of different channels are kept apart, because their standard deviations are only known later. So are those of
different *folds* of time, so that a fit can be validated on folds that it did not use. A channel's rows also make a
*group* for each regime of its joint's motion (:func:`~geomid_ros.model.samples.regimes`): the slower a joint moves, the
less is known of its dry friction. With C channels, group ``C r + c`` is channel c in regime r.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import chain, cycle

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import ChannelSummary, joined, together, triangular, usable
from geomid_ros.estimation.visited_states import Visits
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SummaryState:
    """State of a :class:`RowSummary`.

    Attributes:
        instants, rows: Numbers of samples and of rows added so far.
        time: Time that passed [s].
        weight: Sum of all rows' weights.
        counts: Sums of weights ``(folds, groups)``.
        factors: Triangular factors, by fold and group.
        visited: Visited states of the motion.
    """

    instants: int
    time: float
    rows: int
    weight: float
    counts: FloatArray
    factors: tuple[tuple[FloatArray, ...], ...]
    visited: Visits

    def plus(self, other: SummaryState, pause: float = 0.0) -> SummaryState:
        """Return the state with all rows of both, which have the same channels and folds and forget nothing.

        Args:
            other: rows that were added after these, or to another summary.
            pause: time between the last sample of these and the first of the others [s].
        """
        folds = zip(self.factors, other.factors, strict=True)
        return SummaryState(
            instants=self.instants + other.instants,
            time=self.time + pause + other.time,
            rows=self.rows + other.rows,
            weight=self.weight + other.weight,
            counts=self.counts + other.counts,
            factors=tuple(
                tuple(triangular(np.concatenate(pair)) for pair in zip(*fold, strict=True)) for fold in folds
            ),
            visited=self.visited.plus(other.visited),
        )


class RowSummary:
    """Summaries of all groups in up to ``folds`` consecutive folds of time, an even number.

    All folds but the last one have the same number of samples, at first ``block``. When all folds are full, pairs are
    merged and this number doubles. A row has the weight ``exp(-age / forgetting_time)``; its age [s] is the time added
    by :meth:`add` since.
    """

    # Rows wait until there are this many: one QR of many rows costs less than one QR per row.
    _CHUNK = 128
    _waits = False  # True if all rows wait until they are asked for

    def __init__(
        self,
        channels: Sequence[Channel],
        folds: int = 16,
        block: int = 8,
        forgetting_time: float = np.inf,
        apart: float = 0.0,
    ) -> None:
        """``apart``: time between two rows that are independent after the filter [s]."""
        self.channels = tuple(channels)
        self.folds = folds
        self.visited = Visits(age=apart)
        """Visited states of the motion, if given; none where rows are forgotten."""
        self._apart = apart
        self._block = block
        self._forgetting_time = forgetting_time
        self._instants = 0
        self._time = 0.0
        self.rows = 0
        """Number of rows added, including forgotten ones."""
        self.weight = 0.0
        """Sum of the rows' present weights."""
        self._summaries = self._empty(folds)
        self._complete = True  # no rows wait, and all weights are up to date
        self._factors: tuple[FloatArray, ...] | None = None  # of all rows of each group; None after rows were added

    def _empty(self, folds: int) -> list[list[ChannelSummary]]:
        """Folds without rows."""
        return [[ChannelSummary(np.zeros((0, len(c.columns) + 1))) for c in self.groups] for _ in range(folds)]

    @property
    def groups(self) -> tuple[Channel, ...]:
        """Channel of each group."""
        return self.channels * REGIMES

    @property
    def period(self) -> float:
        """Mean time between two samples [s]; 0 if they have no times."""
        return self._time / max(self._instants, 1)

    def add(
        self,
        coefficients: FloatArray,
        targets: FloatArray,
        elapsed: FloatArray | float = 0.0,
        regimes: IntArray | int = 0,
        states: FloatArray | None = None,
    ) -> None:
        """Add the usable rows of N samples: ``coefficients (N, channels, D)``, ``targets (N, channels)``.

        ``elapsed (N,)``: time [s] by which all earlier rows age. ``regimes (N, channels)``: regimes of the joints'
        motion. ``states (N, S)``: states of the motion, if known.
        """
        elapsed, regimes = np.broadcast_to(elapsed, len(targets)), np.broadcast_to(regimes, targets.shape)
        if states is not None and np.isinf(self._forgetting_time):  # repeats of forgotten rows do not count
            self.visited = self.visited.with_states(states, elapsed, self._apart)
        self._complete = False
        is_usable = usable(coefficients, targets)
        self.rows += int(np.count_nonzero(is_usable))
        for decay, rows in zip(np.exp(-elapsed / self._forgetting_time), np.sum(is_usable, axis=1), strict=True):
            self.weight = self.weight * float(decay) + int(rows)
        times = np.cumsum(np.append(self._time, elapsed))[1:]
        in_group = np.concatenate([is_usable & (regimes == regime) for regime in range(REGIMES)], axis=1)
        begin = 0
        while begin < len(elapsed):
            self._time = float(times[begin])
            self.make_room(1)
            fold = self._summaries[self._instants // self._block]
            end = min(begin + self._block - self._instants % self._block, len(elapsed))
            for index in np.flatnonzero(np.any(in_group[begin:end], axis=0)).tolist():
                channel = index % len(self.channels)
                chosen = begin + np.flatnonzero(in_group[begin:end, index])
                rows = coefficients[chosen[:, None], channel, self.channels[channel].columns]
                fold[index].waiting.append(np.column_stack([rows, targets[chosen, channel], times[chosen]]))
                if self._waits:
                    continue
                # Limits differ, or channels with equally many rows would all need a QR at the same sample.
                limit = self._CHUNK + index
                for rest in range(fold[index].waiting_rows - limit + 1, 0, -limit):
                    fold[index].absorb(limit, float(times[chosen[-rest]]), self._forgetting_time)
            self._instants += end - begin
            self._time = float(times[end - 1])
            if self._instants % self._block == 0 and not self._waits:
                self._absorb_all(fold)  # once, and not in every copy
            begin = end

    def make_room(self, instants: int) -> None:
        """Merge pairs of folds until there is room for this many more samples."""
        while self._instants + instants > self.folds * self._block:
            self._complete_summaries()
            pairs = zip(self._summaries[::2], self._summaries[1::2], strict=True)
            merged = [[together(parts) for parts in zip(*pair, strict=True)] for pair in pairs]
            self._summaries = [*merged, *self._empty(self.folds // 2)]
            self._block *= 2
            self._complete = False

    def absorb(self) -> None:
        """Absorb all rows that wait."""
        self._complete_summaries()

    def _complete_summaries(self) -> list[list[ChannelSummary]]:
        """Summaries of all groups, per fold, including all rows added so far."""
        if not self._complete:
            self._absorb_all(chain(*self._summaries))
            self._complete, self._factors = True, None
        return self._summaries

    def _absorb_all(self, parts: Iterable[ChannelSummary]) -> None:
        for part in parts:
            part.absorb(part.waiting_rows, self._time, self._forgetting_time)

    def parts(self) -> list[tuple[ChannelSummary, ...]]:
        """Summaries of all folds, per group, including all rows added so far."""
        return list(zip(*self._complete_summaries(), strict=True))

    def factors(self) -> tuple[FloatArray, ...]:
        """One factor per group of all rows so far."""
        parts = self.parts()
        if self._factors is None:
            self._factors = tuple(map(joined, parts))
        return self._factors

    def counts(self) -> FloatArray:
        """Sums of the row weights per group."""
        return np.array([sum(part.count for part in by_fold) for by_fold in self.parts()])

    @property
    def never_moved(self) -> BoolArray:
        """True for each channel that is measured at rest alone ``(channels,)``."""
        *moving, rest = self.counts().reshape(REGIMES, -1)
        return np.asarray((rest > 0.0) & ~np.any(moving, axis=0))

    def with_columns(self, channels: Sequence[Channel], chosen: IntArray) -> RowSummary:
        """Copy with only the ``chosen`` of the D parameters; ``channels``: the channels with the remaining columns."""
        copy = self._copy(channels)
        kept_columns = [np.append(np.flatnonzero(np.isin(group.columns, chosen)), -1) for group in self.groups]
        for fold in copy._summaries:  # noqa: SLF001 same class
            for part, columns in zip(fold, kept_columns, strict=True):
                part.factor = part.factor.take(columns, axis=1)
        if self._factors is not None:  # chosen columns of a factor are one, too, of fewer rows than all folds
            pairs = zip(self._factors, kept_columns, strict=True)
            copy._factors = tuple(triangular(factor.take(columns, axis=1)) for factor, columns in pairs)  # noqa: SLF001
        return copy

    def with_added_prediction(self, channel: int, parameters: FloatArray) -> RowSummary:
        """Copy in which the prediction of ``parameters (D,)`` is added to the targets of a channel."""
        copy = self._copy(self.channels)
        subset = parameters[self.channels[channel].columns]
        for fold in copy._summaries:  # noqa: SLF001 same class
            for part in fold[channel :: len(self.channels)]:
                part.factor = triangular(np.column_stack([part.factor[:, :-1], part.factor @ np.append(subset, 1.0)]))
        return copy

    def with_drive_gains(self, gains: FloatArray, links: int) -> RowSummary:
        """Copy in which the first ``links`` parameters count ``gains (channels,)`` times."""
        copy = self._copy(self.channels)
        factors = [
            np.append(np.where(c.columns < links, gain, 1.0), 1.0) for c, gain in zip(copy.channels, gains, strict=True)
        ]
        for part, factor in zip(chain(*copy._summaries), cycle(factors), strict=False):  # noqa: SLF001 same class
            part.factor = part.factor * factor
        return copy

    def pooled(self, channels: BoolArray) -> RowSummary:
        """Copy in which rows of slow motion count as rows of fast motion, for the chosen channels ``(channels,)``."""
        copy = self._copy(self.channels)
        for fold in copy._summaries:  # noqa: SLF001 same class
            for fast in np.flatnonzero(channels).tolist():
                slow = fast + len(self.channels)
                fold[fast] = together([fold[fast], fold[slow]])
                fold[slow] = ChannelSummary(fold[slow].factor[:0])
        return copy

    def snapshot(self) -> RowSummary:
        """Copy that later additions do not change. Its rows wait until they are asked for, also those added to it."""
        snapshot: RowSummary = copy(self)
        snapshot._waits = True
        snapshot._summaries = [[part.copy() for part in fold] for fold in self._summaries]
        return snapshot

    def _copy(self, channels: Sequence[Channel]) -> RowSummary:
        """Copy of all rows added so far, to be changed."""
        self._complete_summaries()
        changed: RowSummary = self.snapshot()
        changed.channels, changed._factors = tuple(channels), None
        return changed

    def state(self) -> SummaryState:
        """State, including all rows added so far."""
        folds = self._complete_summaries()
        return SummaryState(
            instants=self._instants,
            time=self._time,
            rows=self.rows,
            weight=self.weight,
            counts=np.array([[part.count for part in fold] for fold in folds]),
            factors=tuple(tuple(part.factor for part in fold) for fold in folds),
            visited=self.visited,
        )

    def restore(self, state: SummaryState) -> None:
        """Continue from the state of another summary with the same channels and folds.

        Raises InputError, and changes nothing, for a state that no such summary can have.
        """
        numbers = np.array([state.instants, state.time, state.rows, state.weight])
        if state.counts.shape != (self.folds, len(self.groups)) or len(state.factors) != self.folds:
            raise InputError(
                f"rows have {len(state.factors)} folds and counts of shape {state.counts.shape}, expected {self.folds} "
                f"folds of {len(self.groups)} groups"
            )
        if any(len(factors) != len(self.groups) for factors in state.factors):
            raise InputError(f"folds must have {len(self.groups)} groups each")
        if not all(np.all(np.isfinite(array) & (array >= 0.0)) for array in (numbers, state.counts)):
            raise InputError("numbers of rows must be finite and not negative")
        visited = state.visited
        finite = all(np.all(np.isfinite(values)) for values in (visited.kept, visited.last, visited.age))
        if visited.kept.ndim != 3 or not finite or visited.every < 1:
            raise InputError("states of the motion are not finite, or have no valid numbering")
        summaries = [
            [
                ChannelSummary(_checked(factor, channel), float(count), float(state.time))
                for channel, factor, count in zip(self.groups, factors, counts, strict=True)
            ]
            for factors, counts in zip(state.factors, state.counts, strict=True)
        ]
        self._instants, self._time = state.instants, state.time
        while self._instants > self.folds * self._block:
            self._block *= 2
        self.rows, self.weight = state.rows, state.weight
        self.visited = visited
        self._complete, self._factors = True, None
        self._summaries = summaries

    def rms(self, parameters: FloatArray) -> FloatArray:
        """RMS residual of each channel at parameters ``(D,)``, ``(channels,)``; NaN without rows."""
        return self._rms(parameters, self.factors(), self.counts())

    def rms_by_fold(self, parameters: FloatArray) -> FloatArray:
        """:meth:`rms` of the rows of each fold alone ``(folds, channels)``."""
        folds = self._complete_summaries()
        counts = [np.array([part.count for part in fold]) for fold in folds]
        pairs = zip(folds, counts, strict=True)
        return np.array([self._rms(parameters, [part.factor for part in fold], count) for fold, count in pairs])

    def _rms(self, parameters: FloatArray, factors: Sequence[FloatArray], counts: FloatArray) -> FloatArray:
        errors = [
            np.sum((factor @ np.append(parameters[group.columns], -1.0)) ** 2)
            for group, factor in zip(self.groups, factors, strict=True)
        ]
        error, total = (np.sum(np.reshape(sums, (REGIMES, -1)), axis=0) for sums in (errors, counts))
        return np.asarray(np.sqrt(error / np.where(total > 0.0, total, np.nan)))

    def products(self, sigmas: FloatArray, dimension: int) -> FloatArray:
        """Gram matrices ``(folds, D + 1, D + 1)`` of the columns ``[A b]`` of each fold that has rows, in units of the
        standard deviations ``(groups,)``."""
        products, count = np.zeros((self.folds, dimension + 1, dimension + 1)), len(self.channels)
        for index, channel in enumerate(self.channels):  # all its groups at once: they have the same columns
            places = np.append(channel.columns, dimension)
            for block, fold in zip(products, self._complete_summaries(), strict=True):
                pairs = zip(fold[index::count], sigmas[index::count], strict=True)
                rows = np.concatenate([part.factor / sigma for part, sigma in pairs])
                block[places[:, None], places] += rows.T @ rows
        return products[np.any(products, axis=(1, 2))]

    def fold_squares(self, sigmas: FloatArray, vectors: FloatArray) -> FloatArray:
        """Sums of squares ``(folds,)`` of the rows ``[A b]`` of each fold that has rows, in units of the standard
        deviations ``(groups,)``, each times its own one of the ``vectors (folds, D + 1)``."""
        places = [np.append(group.columns, vectors.shape[1] - 1) for group in self.groups]
        with_rows = [fold for fold in self._complete_summaries() if any(np.any(part.factor) for part in fold)]
        return np.array(
            [
                sum(
                    float(np.sum((part.factor @ vector[columns] / sigma) ** 2))
                    for part, sigma, columns in zip(fold, sigmas.tolist(), places, strict=True)
                )
                for fold, vector in zip(with_rows, vectors, strict=True)
            ]
        )

    def compressed(self, sigmas: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray]:
        """Rows ``(<= D, D)`` and targets of standard deviation 1 with the least-squares content of all rows.

        The last row of the factor, in which no parameter appears, is omitted: it is the part of the residual that no
        parameter can change.

        Args:
            sigmas: Standard deviations ``(groups,)``, or ``(channels,)`` for the same in all groups.
            dimension: D.
        """
        # First by channel: most have few columns, and many small decompositions block other threads only briefly.
        stacked = [np.zeros((0, dimension + 1))]
        scales, factors, count = np.resize(sigmas, len(self.groups)), self.factors(), len(self.channels)
        for index, channel in enumerate(self.channels):
            scaled = [factor / sigma for factor, sigma in zip(factors[index::count], scales[index::count], strict=True)]
            factor = triangular(np.concatenate(scaled))
            widened = np.zeros((len(factor), dimension + 1))
            widened[:, channel.columns], widened[:, -1] = factor[:, :-1], factor[:, -1]
            stacked.append(widened)
        compressed_rows = triangular(np.concatenate(stacked))[:dimension]
        return compressed_rows[:, :-1], compressed_rows[:, -1]


def _checked(factor: FloatArray, channel: Channel) -> FloatArray:
    """Return a factor if it is valid for this channel. Raises InputError otherwise."""
    width = len(channel.columns) + 1
    if factor.ndim != 2 or factor.shape[1] != width or len(factor) > width:
        raise InputError(
            f"rows of channel '{channel.name}' have shape {factor.shape}, expected at most ({width}, {width})"
        )
    if not np.all(np.isfinite(factor)):
        raise InputError(f"rows of channel '{channel.name}' are not finite")
    return factor
