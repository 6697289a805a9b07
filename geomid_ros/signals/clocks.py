"""The time between messages by their stamps, which the messages' velocities show to be wrong where they are not the
derivatives of positions; and times for messages that come in bursts, whose stamps do not say them.

Messages that wait somewhere and come together (wireless links, batches of a bus) are stamped when they arrive. If they
were measured with a fixed period, their number in the row says when: the last of a burst waits the least, and all lie
on a line through the last ones.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from geomid_ros.model.samples import STILL
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.settings import CLEAR
from geomid_ros.types import BoolArray, FloatArray, IntArray

_Numbers = TypeVar("_Numbers", FloatArray, IntArray)
FEWEST = 32
"""Messages that the period is inferred from."""
FEWEST_IN_BURSTS = 320
"""The same, where messages come in bursts."""
_UNEVEN = 0.35  # of the time between bursts, that their ends may be off a line
MISSED = 2.5
"""Periods between two messages, or between bursts: more is a pause."""
_LOST = 1.5  # periods that a burst is late by, if messages are missing
_FOLLOWS = 0.05  # of the time that a burst is late by, which the times are moved by


def steps(values: _Numbers, before: _Numbers | int) -> _Numbers:
    """The steps to values ``(N, ...)``, the first one from the value ``before``."""
    found = values.copy()
    found[1:] -= values[:-1]
    found[:1] -= before
    return found


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


SCALED = Reason(
    "velocities are the positions' derivatives but for a factor: do the stamps run too fast or too slow, or is their "
    "unit another one? They are not used",
    "told",
)
_UNITS_OF_SPEED = (180.0 / np.pi, 1000.0, 30.0 / np.pi, 0.5 / np.pi)  # degrees, mrad, 1/min, turns in a rad/s


class VelocityCheck:
    """Tells a wrong clock, or another unit, by the messages' velocities.

    Samples move by their positions alone, as the effects' columns do: what differed between two motions, noise or a
    delay, would tell the inertia of links from that of rotors, and from a carriage's mass.
    """

    _FEWEST = 100  # samples
    _OFF = 0.05
    _IN_PROPORTION = 0.99
    _WRONG_CLOCK = 1.5  # a velocity that is off by less may be a gear's or a filter's

    def __init__(self, joints: int) -> None:
        self._sums = np.zeros((4, joints))  # as of _moments
        self._told = False

    def add(self, given: FloatArray, derived: FloatArray) -> FloatArray:
        """Take velocities of samples, filtered.

        Args:
            given: those of the messages ``(N, joints)``, NaN where there are none.
            derived: the positions' derivatives ``(N, joints)``.

        Returns:
            What the samples until each say ``(4, N, joints)``, for :meth:`are_derivatives`.
        """
        sums = np.cumsum(np.concatenate([self._sums[:, None], _moments(given, derived)], axis=1), axis=1)
        self._sums = sums[:, -1]
        return np.asarray(sums[:, 1:])

    def are_derivatives(self, given: FloatArray, sums: FloatArray) -> BoolArray:
        """Where a message's velocity is the derivative, but for noise ``(N, joints)``, by what :meth:`add` returned."""
        _, _, both, square = sums
        alike = (both > square / self._WRONG_CLOCK) & (both < square * self._WRONG_CLOCK)
        return np.asarray(np.isfinite(given) & alike & ~self._scaled(sums))

    def _telling(self, sums: FloatArray) -> BoolArray:
        """At which joints sums ``(4, ...)`` say what velocities are; where a joint stands still the filter's tails are
        all there is."""
        known, _, both, derived = sums
        return np.asarray((known >= self._FEWEST) & (derived > known * STILL**2) & (both > 0.0))

    def _scaled(self, sums: FloatArray) -> BoolArray:
        """At which joints velocities are the derivatives but for a factor, by sums ``(4, ...)``."""
        _, given, both, derived = sums
        off: BoolArray = np.abs(both - derived) > self._OFF * derived
        if off.any():
            off &= self._telling(sums) & (both**2 > self._IN_PROPORTION * given * derived)
        return off

    @property
    def scaled(self) -> BoolArray:
        """At which joints the messages' velocities are the derivatives but for a factor ``(joints,)``."""
        return self._scaled(self._sums)

    def remark(self) -> Reason | None:
        """What is peculiar about the messages' velocities, said once."""
        if self._told or not self.scaled.any():
            return None
        self._told = True
        rate = self.common_rate()
        return _wrong_clock(rate) if rate else SCALED

    def common_rate(self) -> float:
        """How many times the derivatives the messages' velocities are, if that is the same at all joints that tell and
        no unit's factor; else 0."""
        _, _, both, derived = self._sums
        scaled = self.scaled
        rates = both[scaled] / derived[scaled]
        if len(rates) < 2:
            return 0.0
        alike = np.all(np.abs(rates / np.median(rates) - 1.0) < self._OFF)
        sizes = np.abs(np.log(np.median(rates))) - np.abs(np.log(_UNITS_OF_SPEED))
        of_unit = np.any(np.abs(sizes) < self._OFF)
        far = abs(np.log(np.median(rates))) > np.log(self._WRONG_CLOCK)
        every = far and np.all(scaled | ~self._telling(self._sums))
        return float(np.median(rates)) if every and alike and not of_unit else 0.0


def _moments(given: FloatArray, derived: FloatArray) -> FloatArray:
    """Whether a velocity is given, its square, its product with the derivative, the derivative's square where it is
    given: all ``(4, N, joints)``."""
    known = np.isfinite(given)
    own = np.where(known, given, 0.0)
    return np.array([known, own**2, own * derived, known * derived**2])


def _wrong_clock(rate: float) -> Reason:
    return driver_error(
        f"stamps run {max(rate, 1.0 / rate):.3g} times too {'slow' if rate < 1.0 else 'fast'}: at all "
        "joints the velocities are so many times as small or large as the positions' derivatives; stamp messages in "
        "seconds, when they are measured"
    )
