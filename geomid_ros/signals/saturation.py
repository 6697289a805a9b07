"""Finds saturated efforts: for some time exactly the largest so far, while the joint moves."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import BoolArray, FloatArray

STANDING = 1e-2
"""[rad/s, m/s] a slower robot may send the same numbers twice."""
_SHORTEST, _FEWEST = 50_000_000, 6  # [ns], messages: a saturated effort is exactly the largest for at least so long
_FAR, _FLATTER = 9, 3  # sensor steps below the largest; times as long at the largest as the rise from there took
_MOSTLY = 0.75  # the largest share of all messages in which a saturated effort is the largest
_NEVER = -(2**60)  # the number of a message


class SaturationDetector:
    """Learns the largest effort of every joint and its sensor's steps.

    Rounding keeps a slow curve at its largest, too: -t^2 that just reaches the top level, of depth 1, stays on it for
    2 sqrt(1), and takes sqrt(9) - 1 to it from depth 9; -t^4 stays for 2, and takes 9^(1/4) - 1. A saturated effort
    comes fast and stays. One that is nearly always at its largest is not saturated but constant, as friction at
    constant speed. A coarse or noiseless sensor is mistaken for a saturated one when, after a jump, it shows the same
    during a long acceleration, larger than ever before.
    """

    def __init__(self, joints: int) -> None:
        self._joints = joints
        self._largest = np.full(joints, np.finfo(np.float64).tiny)  # so zeros are never the largest
        self._step = np.full(joints, np.inf)  # smallest change of an effort, at least its sensor's resolution
        self._far = np.full(joints, -np.inf)  # below this an effort is far from the largest
        self._messages = 0
        self._at_largest = np.zeros(joints, dtype=np.int64)  # of the messages so far
        self.restart()

    def restart(self) -> None:
        """Begin anew, as a clock was set back. What was learned is kept."""
        self._largest_since = np.zeros(self._joints, dtype=np.int64)
        # Numbers of the last messages with the effort below the largest, and far below it.
        self._last_below = np.full(self._joints, self._messages)
        self._last_far = np.full(self._joints, _NEVER)
        self._moved = np.zeros(self._joints, dtype=np.bool_)  # while its effort has been the largest

    def saturated(
        self, stamp: int, effort: FloatArray, velocity: FloatArray, moving: bool, before: tuple[int, FloatArray] | None
    ) -> BoolArray:
        """Take a message.

        Args:
            stamp: [ns].
            effort: ``(joints,)``, NaN where it is not measured; so is ``velocity``.
            velocity: ``(joints,)``.
            moving: whether the robot moves.
            before: stamp and efforts of the last good message.

        Returns:
            ``(joints,)`` which efforts are saturated.
        """
        size = np.abs(effort)
        self._messages += 1
        if before is not None:
            self._learn(effort, size, *before)
        largest: BoolArray = size == self._largest
        below = ~largest
        self._at_largest += largest
        self._largest_since[below] = stamp
        self._last_below[below] = self._messages
        self._moved[below] = False
        self._last_far[size < self._far] = self._messages
        if not largest.any():
            return largest
        self._moved |= largest & ~(np.abs(velocity) < STANDING)
        longest = _FEWEST + _FLATTER * (self._last_below - self._last_far)  # that rounding could explain
        long: BoolArray = self._messages - self._last_below >= longest
        if not long.any():
            return long
        seldom = self._at_largest < _MOSTLY * self._messages
        return long & self._moved & moving & seldom & (stamp - self._largest_since >= _SHORTEST)

    def _learn(self, effort: FloatArray, size: FloatArray, stamp: int, last: FloatArray) -> None:
        """Learn how large efforts become, and in which steps. ``stamp`` is that of the ``last`` efforts."""
        change = np.abs(effort - last)
        finer = (change > 0.0) & (change < self._step)
        grown = size > self._largest
        if finer.any() or grown.any():
            self._step[finer] = change[finer]
            self._largest[grown] = size[grown]
            self._largest_since[grown], self._last_below[grown] = stamp, self._messages - 1
            self._moved[grown] = False
            self._far = self._largest - _FAR * self._step
            self._last_far[np.abs(last) < self._far] = self._messages - 1
