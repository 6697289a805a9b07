"""The time between messages by their stamps; and times for messages that come in bursts, whose stamps do not say them.

Messages that wait somewhere and come together (wireless links, batches of a bus) are stamped when they arrive. If they
were measured with a fixed period, their number in the row says when: the last of a burst waits the least, and all lie
on a line through the last ones.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.signals.settings import CLEAR
from geomid_ros.types import IntArray

FEWEST = 32
"""Messages that the period is inferred from."""
FEWEST_IN_BURSTS = 320
"""The same, where messages come in bursts."""
_UNEVEN = 0.35  # of the time between bursts, that their ends may be off a line
MISSED = 2.5
"""Periods between two messages, or between bursts: more is a pause."""
_LOST = 1.5  # periods that a burst is late by, if messages are missing
_FOLLOWS = 0.05  # of the time that a burst is late by, which the times are moved by


def in_bursts(stamps: IntArray, max_gap: int) -> bool:
    """Whether more than a quarter of the steps between increasing stamps are shorter than a quarter of the mean step.
    Steps longer than ``max_gap`` [ns] do not count."""
    steps = np.diff(stamps)
    steps = steps[steps <= max_gap]
    return bool(len(steps) and np.mean(steps < np.mean(steps) / CLEAR) > 1.0 / CLEAR)


class RegularClock:
    """Times of messages that come in bursts, by their number in the row."""

    def __init__(self, stamps: IntArray) -> None:
        """
        Args:
            stamps: of the first messages [ns], which are still to be given to :meth:`times`.
        """
        steps = np.diff(stamps)
        ends = np.flatnonzero(steps > np.mean(steps))
        times = (stamps[ends] - stamps[0]).astype(float)
        period, begin = map(float, np.polyfit(ends, times, 1))
        self.period = period
        """Time between messages [ns]."""
        self._between = float(period * np.mean(np.diff(ends)))  # bursts
        self.is_right = bool(period > 0.0 and np.std(times - begin - period * ends) < _UNEVEN * self._between)
        """Whether the numbers of messages say when they were measured."""
        self._origin = self._last = int(stamps[0])
        self._time = begin - period  # of the message before, since the origin [ns]

    def times(self, stamps: IntArray) -> IntArray:
        """The times [ns] of the next messages, by their stamps ``(N,)``."""
        found = np.empty(len(stamps))
        for index, stamp in enumerate(stamps.tolist()):
            found[index] = self._time = self._time + max(self._step(stamp), 0.5 * self.period)
            self._last = stamp
        return self._origin + np.round(found).astype(np.int64)

    def _step(self, stamp: int) -> float:
        """The time [ns] from the message before to the one with this stamp."""
        waited = stamp - self._last
        if waited > MISSED * self._between:
            return waited - self._between + self.period
        if waited < self.period:
            return self.period
        late = self._last - self._origin - self._time  # the message before was the last of a burst
        return self.period + (late if abs(late) > _LOST * self.period else _FOLLOWS * late)
