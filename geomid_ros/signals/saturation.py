"""Finds saturated efforts: for some time exactly the largest so far, while the joint moves."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import BoolArray, FloatArray, IntArray

STANDING = 1e-2
"""[rad/s, m/s] a slower robot may send the same numbers twice."""
_SHORTEST, _FEWEST = 50_000_000, 6  # [ns], messages: a saturated effort is exactly the largest for at least so long
_FAR, _FLATTER = 9, 3  # sensor steps below the largest; times as long at the largest as the rise from there took
_LONGER = 2  # times as long as smaller efforts stay the same
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
        self._messages = 0
        self._at_largest = np.zeros(joints, dtype=np.int64)  # of the messages so far
        self._held = np.zeros(joints, dtype=np.int64)  # messages in which a smaller effort stayed the same
        self.restart()

    def restart(self) -> None:
        """Begin anew, as a clock was set back. What was learned is kept."""
        self._largest_since = np.zeros(self._joints, dtype=np.int64)
        # Numbers of the last messages with the effort below the largest, and far below it.
        self._last_below = np.full(self._joints, self._messages)
        self._last_far = np.full(self._joints, _NEVER)
        self._begun = np.full(self._joints, self._messages)  # since when efforts have been the same
        self._moved = np.zeros(self._joints, dtype=np.bool_)  # while its effort has been the largest

    def saturated(
        self,
        stamps: IntArray,
        effort: FloatArray,
        velocity: FloatArray,
        moving: BoolArray,
        before: tuple[int, FloatArray] | None,
    ) -> BoolArray:
        """Take N messages; what is found of several holds only if all of them are good, as each is compared with the
        one before.

        Args:
            stamps: ``(N,)`` [ns].
            effort: ``(N, joints)``, NaN where it is not measured; so is ``velocity``.
            velocity: ``(N, joints)``.
            moving: ``(N,)`` whether the robot moves.
            before: stamp and efforts of the last good message.

        Returns:
            ``(N, joints)`` which efforts are saturated.
        """
        first, efforts = before or (0, np.full(self._joints, np.nan))
        size, last = np.abs(effort), np.vstack([efforts, effort[:-1]])
        numbers = np.broadcast_to(self._messages + 1 + np.arange(len(stamps))[:, None], size.shape)
        record, grown, last_far = self._learn(numbers, size, np.abs(effort - last), np.abs(last), before is not None)
        largest: BoolArray = size == record
        below = ~largest
        last_below = _latest(np.where(below, numbers, np.where(grown, numbers - 1, _NEVER)), self._last_below)
        ended = np.logical_or.accumulate(below | grown)  # what was the largest before these messages
        since = np.concatenate([[first], stamps])[np.maximum(last_below - self._messages, 0)]
        since = np.where(ended, since, self._largest_since)
        moves = np.where(largest & ~(np.abs(velocity) < STANDING), numbers, _NEVER)
        moved = (_latest(moves, np.full(self._joints, _NEVER)) > last_below) | (self._moved & ~ended)
        count = self._at_largest + np.cumsum(largest, axis=0)
        held = self._learn_held(numbers, effort != last, np.abs(last), record, grown, moving)
        longest = _FEWEST + _FLATTER * (last_below - last_far)  # that rounding could explain
        longest = np.maximum(longest, _LONGER * held)
        found: BoolArray = (numbers - last_below >= longest) & moved & moving[:, None]
        found &= (count < _MOSTLY * numbers) & (stamps[:, None] - since >= _SHORTEST)
        self._messages += len(stamps)
        self._last_below, self._largest_since = last_below[-1], since[-1]
        self._moved, self._at_largest = moved[-1], count[-1]
        return found

    def _learn(
        self, numbers: IntArray, size: FloatArray, change: FloatArray, last: FloatArray, known: bool
    ) -> tuple[FloatArray, BoolArray, IntArray]:
        """Learn how large efforts become, and in which steps.

        Args:
            numbers: of the messages ``(N, joints)``.
            size: of their efforts ``(N, joints)``.
            change: from those before ``(N, joints)``.
            last: sizes of those before ``(N, joints)``.
            known: whether there is a message before the first one; else that is not learnt from.

        Returns:
            ``(N, joints)`` the largest so far, where one is larger than ever, and the number of the last message in
            which it was far below that.
        """
        sizes = np.vstack([self._largest, size])
        sizes[1] = sizes[1] if known else np.nan
        largest = np.fmax.accumulate(sizes)
        step = np.fmin.accumulate(np.vstack([self._step, np.where(change > 0.0, change, np.inf)]))
        far = largest[1:] - _FAR * step[1:]
        grown: BoolArray = largest[1:] > largest[:-1]
        news: BoolArray = np.any(grown | (step[1:] < step[:-1]), axis=1, keepdims=True)
        were_far = np.where(news & (last < far), numbers - 1, _NEVER)
        last_far = _latest(np.where(size < far, numbers, were_far), self._last_far)
        self._largest, self._step, self._last_far = largest[-1], step[-1], last_far[-1]
        return largest[1:], grown, last_far

    def _learn_held(
        self,
        numbers: IntArray,
        new: BoolArray,
        last: FloatArray,
        largest: FloatArray,
        grown: BoolArray,
        moving: BoolArray,
    ) -> IntArray:
        """Learn for how many messages efforts stay the same though they are not the largest: those of a driver that
        renews them seldom do.

        Args:
            numbers: of the messages ``(N, joints)``.
            new: whether efforts are others than those before ``(N, joints)``.
            last: sizes of those before ``(N, joints)``.
            largest: ``(N, joints)`` so far.
            grown: where one is larger than ever ``(N, joints)``.
            moving: ``(N,)`` whether the robot moves.

        Returns:
            ``(N, joints)`` the most messages so far.
        """
        begun = _latest(np.where(new | ~moving[:, None], numbers, _NEVER), self._begun)
        begun_before = np.vstack([self._begun, begun[:-1]])
        counts = np.where(new & moving[:, None] & (grown | (last < largest)), numbers - begun_before, 0)
        held = _latest(counts, self._held)
        self._begun, self._held = begun[-1], held[-1]
        return held


def _latest(numbers: IntArray, before: IntArray) -> IntArray:
    """The largest number so far ``(N, joints)``."""
    latest: IntArray = np.maximum(np.maximum.accumulate(numbers), before)
    return latest
