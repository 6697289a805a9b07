"""Whether a robot still is what it was: the part of new rows that no parameters explain together with all rows before.

For the rows ``[A b]`` of one channel the sum of squares that is left by least squares grows with every block of new
rows by ``e^T (I + A P A^T)^-1 e``, with e the errors of the prediction from the rows before and P its uncertainty
(recursive residuals; Brown, Durbin, Evans 1975). A new motion that shows new parameters does not add to it more than
noise does, however wrong the estimate was before; a robot that has changed does. No prior takes part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.summary import triangular, usable
from geomid_ros.model.measurement import Channel, Rows
from geomid_ros.types import FloatArray, IntArray

BLOCK = 40
"""Rows that are judged together: five periods of the filter's cutoff, where the messages are frequent enough."""
FALSE_ALARMS = 1e-7
"""Of all blocks, at most so many open a gap of a channel whose noise is what it was."""
_MOST_WAITING = 50_000_000  # bytes
_ROWS_PER_PARAMETER = 8  # before which there is no floor: filtered rows are not independent
_FEWEST_BLOCKS = 12
_MOST_BLOCKS = 60
_CAUTION = 2.0  # standard deviations by which the floor may be higher than the energies' mean
_MOST_SUSPECT = 20  # blocks
_RISE = 2.25  # of the variance: a gap of 1.5 times the floor is what the test looks for
_FEWEST_BAD = 3  # blocks that an alarm takes: a push or a bump is no gap
_SUSPICION = -float(np.log(FALSE_ALARMS)) / _FEWEST_BAD  # what one block can say at most
_ALARM = _FEWEST_BAD * _SUSPICION
_LARGEST_SHAPE = 0.5 * BLOCK  # of a block of independent rows
_LAGS = 3  # blocks over which energies may be correlated
_LEAST_FLOOR = 1e-4  # of the measured values: below, rounding and the filter's ripple count
_LONGEST_STEP = 1.0  # [s] between rows; a longer pause counts as so long


@dataclass(frozen=True)
class ChannelGap:
    """A watched channel: the root mean square of its last rows in units of the floor, and the stamp [ns] since which
    that is a gap, None if it is none. ``first``: the number of the instant at that stamp."""

    channel: str
    times_floor: float
    since: int | None
    first: int = 0


class GapWatch:
    """Learns from the first rows what is normal, and from then on says which channels are no longer.

    One thread may call :meth:`add` while another calls all else.
    """

    def __init__(self, channels: Sequence[Channel], forgetting_time: float = np.inf) -> None:
        """``forgetting_time`` [s]: what is normal is what was so long ago; but not forgotten before it is known."""
        self._channels = [_ChannelWatch(channel, forgetting_time) for channel in channels]
        instant = 8 * len(channels) * max((int(np.max(c.columns, initial=0)) + 2 for c in channels), default=1)
        most = max(BLOCK, _MOST_WAITING // instant)
        self._waiting: deque[tuple[int, int, FloatArray, FloatArray]] = deque(maxlen=most)
        self._gaps: tuple[ChannelGap, ...] = ()
        self.judged = 0
        """The number of the first instant that is not judged yet."""

    def add(self, first: int, stamps: IntArray, rows: Rows) -> None:
        """Take rows of a robot that moves, in the order of time; of those that nobody judges the last are kept.

        Instants are counted: ``first`` is the number of the first one."""
        numbers = range(first, first + len(stamps))
        self._waiting.extend(zip(numbers, stamps.tolist(), rows.coefficients, rows.targets, strict=True))

    def judge(self) -> bool:
        """Judge the next whole block that waits; False if there is none."""
        if len(self._waiting) < BLOCK:
            return False
        block = (self._waiting.popleft() for _ in range(BLOCK))
        numbers, stamps, coefficients, targets = zip(*block, strict=True)
        rows = Rows(np.array(coefficients), np.array(targets))
        for index, channel in enumerate(self._channels):
            channel.judge(numbers[0], np.array(stamps), rows.coefficients[:, index], rows.targets[:, index])
        self._gaps = tuple(channel.gap for channel in self._channels if channel.watched)
        self.judged = numbers[-1] + 1
        return True

    def normal(self, channels: Sequence[int]) -> int:
        """The number of the instant before which these channels were found to be what they were.

        What follows is still to be judged, suspect, or of an open gap: but of what is as long ago as that a suspicion
        that has not been confirmed is forgotten, and nothing is said of it any more."""
        suspect = [self._channels[index].first_suspect for index in channels]
        begin = min([self.judged, *(first for first in suspect if first is not None)])
        # A change in the last rows of a block does not show there.
        return max(begin - BLOCK, self.judged - _MOST_SUSPECT * BLOCK)

    @property
    def gaps(self) -> tuple[ChannelGap, ...]:
        """The watched channels as they were judged last."""
        return self._gaps


class _ChannelWatch:
    """A one-sided cumulative sum test (Page 1954) of whether blocks' energies have risen by ``_RISE``.

    The energies of blocks, per row, are taken to be Gamma-distributed with the mean of those before and a shape by
    their long-run variance, which has room for noise that is correlated and that differs between parts of the motion.
    Where that is so, the mean time between false alarms is at least ``1 / FALSE_ALARMS`` blocks (Lorden 1971); that no
    block counts for more than a share of the alarm makes them rarer.
    """

    def __init__(self, channel: Channel, forgetting_time: float) -> None:
        self._channel = channel
        self._forgetting_time = forgetting_time
        self._factor = np.zeros((0, len(channel.columns) + 1))
        self._rows = 0
        self._last_stamp: int | None = None
        self._energies: deque[float] = deque(maxlen=_MOST_BLOCKS)
        self._suspect: deque[tuple[float, FloatArray]] = deque(maxlen=_MOST_SUSPECT)  # energies and rows
        self._ratios: deque[float] = deque(maxlen=_FEWEST_BAD)
        self._evidence = 0.0  # for an opening, or, when it is open, for its end
        self._since = self._first = 0
        self._open = False

    @property
    def watched(self) -> bool:
        """Whether it is known what is normal."""
        return len(self._energies) >= _FEWEST_BLOCKS

    @property
    def gap(self) -> ChannelGap:
        """What is to be said of the last blocks."""
        size = float(np.sqrt(np.mean(self._ratios))) if self._ratios else 1.0
        return ChannelGap(self._channel.name, size, self._since if self._open else None, self._first)

    @property
    def first_suspect(self) -> int | None:
        """The number of the first instant that may be, or is, in a gap; None if there is none."""
        return self._first if self._open or self._evidence > 0.0 else None

    def judge(self, first: int, stamps: IntArray, coefficients: FloatArray, targets: FloatArray) -> None:
        """Take a block that begins with the instant of number ``first``: ``stamps (N,)``, ``coefficients (N, D)``,
        ``targets (N,)``."""
        share = self._remaining(stamps)
        measured = usable(coefficients, targets)
        rows = np.column_stack([coefficients[:, self._channel.columns], targets])[measured]
        if len(rows) < BLOCK // 2:
            return
        self._factor = np.sqrt(share) * self._factor
        joined = triangular(np.concatenate([self._factor, rows]))
        energy = max(_unexplained(joined) - _unexplained(self._factor), 0.0) / len(rows)
        if self.watched:
            self._test(energy, first, int(stamps[0]))
        self._suspect.append((energy, rows))
        if self._open:
            self._suspect.clear()
        elif self._evidence == 0.0:
            self._learn()
        if self._open and np.isfinite(self._forgetting_time):
            self._factor = joined

    def _learn(self) -> None:
        """What was suspect is normal."""
        while self._suspect:
            energy, rows = self._suspect.popleft()
            if self._rows >= _ROWS_PER_PARAMETER * len(self._channel.columns):
                self._energies.append(energy)
            self._factor = triangular(np.concatenate([self._factor, rows]))
            self._rows += len(rows)

    def _remaining(self, stamps: IntArray) -> float:
        """The weight that the rows before keep; not so little that nothing would be known of what is normal."""
        previous, self._last_stamp = self._last_stamp, int(stamps[-1])
        steps = np.diff(stamps, prepend=stamps[0] if previous is None else previous) * 1e-9
        elapsed = float(np.sum(np.clip(steps, 0.0, _LONGEST_STEP)))
        fewest = 2.0 * _ROWS_PER_PARAMETER * max(len(self._channel.columns), 1)
        return max(float(np.exp(-elapsed / self._forgetting_time)), 1.0 - BLOCK / fewest)

    def _test(self, energy: float, first: int, stamp: int) -> None:
        level = self._level
        if level == 0.0:  # all that was measured is zero
            return
        self._ratios.append(energy / level)
        shape = self._shape(level)
        highest = level * (1.0 + _CAUTION / np.sqrt(shape * len(self._energies)))
        rise = shape * (energy / highest * (1.0 - 1.0 / _RISE) - np.log(_RISE))
        if not self._open and self._evidence == 0.0:
            self._first, self._since = first, stamp
        self._evidence = max(0.0, self._evidence + min(-rise if self._open else rise, _SUSPICION))
        if self._evidence >= (_SUSPICION if self._open else _ALARM):
            self._open, self._evidence = not self._open, 0.0

    @property
    def _level(self) -> float:
        """The normal energy per row."""
        smallest = _LEAST_FLOOR**2 * float(np.sum(self._factor[:, -1] ** 2)) / self._rows
        return max(float(np.mean(self._energies)), smallest)

    def _shape(self, level: float) -> float:
        """Of the Gamma distribution, rather too small: few energies tell their variance only roughly."""
        errors = np.array(self._energies) - np.mean(self._energies)
        count = len(errors)
        covariance = [float(errors[lag:] @ errors[: count - lag]) / count for lag in range(_LAGS + 1)]
        long_run = covariance[0] + 2.0 * sum((1.0 - lag / (_LAGS + 1)) * covariance[lag] for lag in range(1, _LAGS + 1))
        variance = max(long_run, covariance[0]) * (1.0 + 4.0 / np.sqrt(count))
        return min(level**2 / variance, _LARGEST_SHAPE) if variance > 0.0 else _LARGEST_SHAPE


def _unexplained(factor: FloatArray) -> float:
    """The sum of squares that is left by least squares."""
    return float(factor[-1, -1] ** 2) if len(factor) == factor.shape[1] else 0.0
