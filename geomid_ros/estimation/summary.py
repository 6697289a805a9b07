"""A bounded memory of any number of rows: their least-squares content, kept by QR.

Factors of different channels are kept apart, because their standard deviations are only known later, and so are those
of different *folds* of time, so that what was not used for a fit can judge it. For the same reason a channel's rows
make a *group* for each regime of its joint's motion (:func:`~geomid_ros.model.samples.regimes`): the slower a joint
moves, the less is known of its dry friction. Of C channels the group ``C r + c`` is channel c's in regime r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import ChannelSummary, joined, together, triangular, usable
from geomid_ros.estimation.visited_states import VisitedStates, Visits
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import REGIMES
from geomid_ros.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SummaryState:
    """The state of a :class:`RowSummary`.

    Attributes:
        instants, rows: Numbers added so far.
        time: Time that passed [s].
        weight: Sum of all rows' weights.
        counts: Sums of weights ``(folds, groups)``.
        factors: By fold and group.
        visited: The states of the motion.
    """

    instants: int
    time: float
    rows: int
    weight: float
    counts: FloatArray
    factors: tuple[tuple[FloatArray, ...], ...]
    visited: Visits

    def plus(self, other: SummaryState, pause: float = 0.0) -> SummaryState:
        """All rows of both, of the same channels and folds, where nothing is forgotten.

        Args:
            other: rows that were added after these, or to another summary.
            pause: time between the last instant of these and the first of the others [s].
        """
        factors = tuple(
            tuple(triangular(np.concatenate(pair)) for pair in zip(own, others, strict=True))
            for own, others in zip(self.factors, other.factors, strict=True)
        )
        visited = VisitedStates()
        for each in (self, other):
            visited.plus(each.visited)
        return SummaryState(
            instants=self.instants + other.instants,
            time=self.time + pause + other.time,
            rows=self.rows + other.rows,
            weight=self.weight + other.weight,
            counts=self.counts + other.counts,
            factors=factors,
            visited=visited.visits,
        )


class RowSummary:
    """Summaries of all groups in up to ``folds`` folds, an even number, that follow one another in time.

    They are of equally many instants, the last one apart: of ``block`` at first, and of twice as many each time when
    all folds are full and two and two become one. A row weighs ``exp(-age / forgetting_time)``; its age [s] is that of
    :meth:`add`.
    """

    # Rows wait until so many are there: a QR of many at once costs less than one of each.
    _CHUNK = 128

    def __init__(
        self,
        channels: Sequence[Channel],
        folds: int = 16,
        block: int = 8,
        forgetting_time: float = np.inf,
        apart: float = 0.0,
    ) -> None:
        """``apart``: time between two rows that the filter leaves independent [s]."""
        self.channels = tuple(channels)
        self.folds = folds
        self.visited = VisitedStates(apart)
        """The states of the motion, as far as they were given; none where rows are forgotten."""
        self._block = block
        self._forgetting_time = forgetting_time
        self._instants = 0
        self._time = 0.0
        self.rows = 0
        """Number of rows added, forgotten ones included."""
        self.weight = 0.0
        """Sum of the weights that they have now."""
        self._summaries = [
            [ChannelSummary(np.zeros((0, len(c.columns) + 1))) for c in self.groups] for _ in range(folds)
        ]
        self._complete = True  # nothing waits, and all weights are those of now
        self._factors: tuple[FloatArray, ...] | None = None  # of all rows of each group, while none are added
        # Rows, their targets, and their times.
        self._waiting: list[list[list[tuple[FloatArray, float, float]]]] = [
            [[] for _ in self.groups] for _ in range(folds)
        ]

    @property
    def groups(self) -> tuple[Channel, ...]:
        """The channel of each group."""
        return self.channels * REGIMES

    @property
    def period(self) -> float:
        """Mean time between two instants [s]; 0 if they have no times."""
        return self._time / max(self._instants, 1)

    def add(
        self,
        coefficients: FloatArray,
        targets: FloatArray,
        elapsed: FloatArray | float = 0.0,
        regimes: IntArray | int = 0,
        states: FloatArray | None = None,
    ) -> None:
        """Add the rows of N instants that are usable: ``coefficients (N, channels, D)``, ``targets (N, channels)``.

        By ``elapsed (N,)`` [s] all earlier rows grow older. ``regimes (N, channels)`` of the joints' motion, and its
        ``states (N, S)``, if they are known.
        """
        elapsed, regimes = np.broadcast_to(elapsed, len(targets)), np.broadcast_to(regimes, targets.shape)
        if states is not None and np.isinf(self._forgetting_time):  # repeats of what is forgotten do not count
            self.visited.add(states, elapsed)
        self._complete = False
        taken = usable(coefficients, targets)
        self.rows += int(np.count_nonzero(taken))
        for share, rows in zip(np.exp(-elapsed / self._forgetting_time), np.sum(taken, axis=1), strict=True):
            self.weight = self.weight * float(share) + int(rows)
        times = np.cumsum(np.append(self._time, elapsed))[1:]
        begin = 0
        while begin < len(elapsed):
            self._time = float(times[begin])
            fold = self._fold()
            end = min(begin + self._block - self._instants % self._block, len(elapsed))
            for index, group in enumerate(self.groups):
                regime, channel = divmod(index, len(self.channels))
                own = taken[begin:end, channel] & (regimes[begin:end, channel] == regime)
                if not np.any(own):
                    continue
                chosen = begin + np.flatnonzero(own)
                rows = coefficients[chosen[:, None], channel, group.columns]
                waiting = self._waiting[fold][index]
                waiting += zip(rows, targets[chosen, channel].tolist(), times[chosen].tolist(), strict=True)
                # Channels that have as many rows wait differently long: few instants cost more than one QR.
                while len(waiting) >= self._CHUNK + index:
                    self._absorb(fold, index, self._CHUNK + index)
            self._instants += end - begin
            self._time = float(times[end - 1])
            begin = end

    def _fold(self) -> int:
        """The fold of the next instant, for which there is room."""
        self.make_room(1)
        return self._instants // self._block

    def make_room(self, instants: int) -> None:
        """Let blocks be so long that there are folds for so many more instants."""
        while self._instants + instants > self.folds * self._block:
            parts = self.parts()
            for index, own in enumerate(parts):
                pairs = [own[first : first + 2] for first in range(0, self.folds, 2)]
                empty = [ChannelSummary(own[0].factor[:0]) for _ in pairs]
                for fold, part in enumerate([*map(together, pairs), *empty]):
                    self._summaries[fold][index] = part
            self._block *= 2
            self._complete = False

    def absorb_one(self) -> bool:
        """Absorb what waits of one channel; False if there was nothing."""
        for fold in range(self.folds):
            for index, waiting in enumerate(self._waiting[fold]):
                if waiting:
                    self._absorb(fold, index)
                    return True
        return False

    def _absorb(self, fold: int, index: int, count: int | None = None) -> None:
        """Absorb what waits, as of now; or the first rows, so many, as of the last of them."""
        part, waiting = self._summaries[fold][index], self._waiting[fold][index]
        now = self._time if count is None else waiting[count - 1][2]
        remaining = float(self._remaining(part.time, now))
        if remaining < 1.0:  # otherwise copies share the factor
            part.fade(remaining)
        if waiting:
            rows, targets, times = zip(*waiting[:count], strict=True)
            part.add(np.array(rows), np.array(targets), self._remaining(np.array(times), now))
            del waiting[:count]
        part.time = now
        self._factors = None

    def _remaining(self, times: float | FloatArray, now: float) -> FloatArray:
        """Weights that rows added at ``times`` have at another."""
        return np.exp((np.asarray(times) - now) / self._forgetting_time)

    def parts(self) -> list[list[ChannelSummary]]:
        """Per group the summaries of all folds, everything added so far included."""
        if not self._complete:
            for fold in range(self.folds):
                for index in range(len(self.groups)):
                    self._absorb(fold, index)
            self._complete = True
        return [[fold[index] for fold in self._summaries] for index in range(len(self.groups))]

    def factors(self, folds: Sequence[int] | None = None) -> tuple[FloatArray, ...]:
        """Per group one factor of all rows of the chosen folds (all unless given), everything added so far included."""
        parts = self.parts()
        if folds is not None:
            return tuple(joined([own[fold] for fold in folds]) for own in parts)
        if self._factors is None:
            self._factors = tuple(map(joined, parts))
        return self._factors

    def counts(self, folds: Sequence[int] | None = None) -> FloatArray:
        """Sums of the weights of each group's rows in the chosen folds (all unless given)."""
        chosen = range(self.folds) if folds is None else folds
        return np.array([sum(own[fold].count for fold in chosen) for own in self.parts()])

    def with_columns(self, channels: Sequence[Channel], chosen: IntArray) -> RowSummary:
        """A copy in which only the ``chosen`` of the D parameters are left; ``channels`` are those of what is left."""
        copy = self._copy(channels)
        kept = [np.append(np.flatnonzero(np.isin(group.columns, chosen)), -1) for group in self.groups]
        for fold in copy._summaries:  # noqa: SLF001 its own
            for part, own in zip(fold, kept, strict=True):
                part.factor = part.factor.take(own, axis=1)
        if self._factors is not None:  # their columns are factors, too, and lower than those of all folds together
            pairs = zip(self._factors, kept, strict=True)
            copy._factors = tuple(triangular(factor.take(own, axis=1)) for factor, own in pairs)  # noqa: SLF001
        return copy

    def with_more(self, channel: int, parameters: FloatArray) -> RowSummary:
        """A copy in which the targets of a channel have what ``parameters (D,)`` predict added."""
        copy = self._copy(self.channels)
        own = parameters[self.channels[channel].columns]
        for fold in copy._summaries:  # noqa: SLF001 its own
            for part in fold[channel :: len(self.channels)]:
                part.factor = triangular(np.column_stack([part.factor[:, :-1], part.factor @ np.append(own, 1.0)]))
        return copy

    def pooled(self, channels: BoolArray) -> RowSummary:
        """A copy in which the rows of slow motion are among those of fast motion, for some channels ``(channels,)``."""
        copy = self._copy(self.channels)
        for fold in copy._summaries:  # noqa: SLF001 its own
            for fast in np.flatnonzero(channels).tolist():
                slow = fast + len(self.channels)
                fold[fast] = together([fold[fast], fold[slow]])
                fold[slow] = ChannelSummary(fold[slow].factor[:0])
        return copy

    def snapshot(self) -> RowSummary:
        """A copy that later additions do not change."""
        return self._copy(self.channels)

    def _copy(self, channels: Sequence[Channel]) -> RowSummary:
        copy = RowSummary(channels, self.folds, self._block, self._forgetting_time)
        copy._instants, copy._time = self._instants, self._time
        copy.rows, copy.weight, copy.visited = self.rows, self.weight, self.visited.copy()
        copy._summaries = [[part.copy() for part in fold] for fold in zip(*self.parts(), strict=True)]
        return copy

    def state(self) -> SummaryState:
        """The state, everything added so far included."""
        folds = list(zip(*self.parts(), strict=True))
        counts = np.array([[part.count for part in fold] for fold in folds])
        factors = tuple(tuple(part.factor for part in fold) for fold in folds)
        return SummaryState(
            instants=self._instants,
            time=self._time,
            rows=self.rows,
            weight=self.weight,
            counts=counts,
            factors=factors,
            visited=self.visited.visits,
        )

    def restore(self, state: SummaryState) -> None:
        """Take the state of another summary of the same channels and folds.

        Raises InputError, and changes nothing, for a state that no such summary can have.
        """
        numbers = np.array([state.instants, state.time, state.rows, state.weight])
        if state.counts.shape != (self.folds, len(self.groups)) or len(state.factors) != self.folds:
            raise InputError(f"{len(state.factors)} folds, expected {self.folds} of {len(self.channels)} channels")
        if any(len(factors) != len(self.groups) for factors in state.factors):
            raise InputError(f"folds of other groups, expected {len(self.groups)} groups in each")
        if not all(np.all(np.isfinite(array) & (array >= 0.0)) for array in (numbers, state.counts)):
            raise InputError("numbers of rows that are negative or not finite")
        visited = state.visited
        finite = all(np.all(np.isfinite(own)) for own in (visited.kept, visited.last, visited.age))
        if visited.kept.ndim != 3 or not finite or visited.every < 1:
            raise InputError("states of a motion that are not finite, or not numbered")
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
        self.visited.restore(visited)
        self._complete, self._factors = True, None
        self._summaries = summaries
        self._waiting = [[[] for _ in self.groups] for _ in range(self.folds)]

    def rms(self, parameters: FloatArray, folds: Sequence[int] | None = None) -> FloatArray:
        """Root mean square of each channel's residual at parameters ``(D,)``, ``(channels,)``; NaN without rows."""
        errors = [
            np.sum((factor @ np.append(parameters[group.columns], -1.0)) ** 2)
            for group, factor in zip(self.groups, self.factors(folds), strict=True)
        ]
        error, total = (np.sum(np.reshape(each, (REGIMES, -1)), axis=0) for each in (errors, self.counts(folds)))
        return np.asarray(np.sqrt(error / np.where(total > 0.0, total, np.nan)))

    def products(self, sigmas: FloatArray, dimension: int) -> FloatArray:
        """Of each fold that has rows: the columns ``[A b]`` of its rows by each other, ``(folds, D + 1, D + 1)``, in
        units of the standard deviations ``(groups,)``."""
        products = np.zeros((self.folds, dimension + 1, dimension + 1))
        for group, parts, sigma in zip(self.groups, self.parts(), sigmas, strict=True):
            own = np.append(group.columns, dimension)
            products[:, own[:, None], own] += np.array([part.factor.T @ part.factor for part in parts]) / sigma**2
        return products[np.any(products, axis=(1, 2))]

    def compressed(self, sigmas: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray]:
        """Rows ``(<= D, D)`` and targets of standard deviation 1 with the least-squares content of all rows.

        The last row of the factor, in which no parameter appears, is left out: it is the part of the residual that no
        parameter can change.

        Args:
            sigmas: Standard deviations ``(groups,)``, or ``(channels,)`` for those of both groups.
            dimension: D.
        """
        # First by channel: most have few columns, and many small decompositions stop no other thread for long.
        stacked = [np.zeros((0, dimension + 1))]
        scales, factors, count = np.resize(sigmas, len(self.groups)), self.factors(), len(self.channels)
        for index, channel in enumerate(self.channels):
            own = [factor / sigma for factor, sigma in zip(factors[index::count], scales[index::count], strict=True)]
            factor = triangular(np.concatenate(own))
            widened = np.zeros((len(factor), dimension + 1))
            widened[:, channel.columns], widened[:, -1] = factor[:, :-1], factor[:, -1]
            stacked.append(widened)
        whole = triangular(np.concatenate(stacked))[:dimension]
        return whole[:, :-1], whole[:, -1]


def _checked(factor: FloatArray, channel: Channel) -> FloatArray:
    """A factor that can be of this channel. Raises InputError otherwise."""
    width = len(channel.columns) + 1
    if factor.ndim != 2 or factor.shape[1] != width or len(factor) > width:
        raise InputError(f"rows of channel '{channel.name}' are {factor.shape}, expected at most ({width}, {width})")
    if not np.all(np.isfinite(factor)):
        raise InputError(f"rows of channel '{channel.name}' are not finite")
    return factor
