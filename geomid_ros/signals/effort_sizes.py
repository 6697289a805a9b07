"""How large efforts are: what is no motion but a spike, and what is saturated."""

from __future__ import annotations

import numpy as np

from geomid_ros.model.samples import STILL
from geomid_ros.signals.limits import LONGEST_SAME
from geomid_ros.types import BoolArray, FloatArray, IntArray

_CHUNK = 128  # messages that are learned from at once
_TAIL = 6  # messages of a chunk, at either end, that do not count
_IN_RANGE, _IN_CHANGES, _IN_LIMIT = 1.5, 8.0, 0.02  # times the range of efforts, their changes, and the URDF's limit
_LONG = 6  # messages at least, and times as long as any smaller effort stayed the same
_MOSTLY = 0.75  # the largest share of all messages in which a saturated effort is the largest


class SpikeHeights:
    """Learns from chunks of messages; what it says changes with a whole chunk only."""

    def __init__(self, limits: FloatArray) -> None:
        """
        Args:
            limits: ``(joints,)`` of efforts, infinite where there is none.
        """
        joints = len(limits)
        self._limit = np.where(np.isfinite(limits), _IN_LIMIT * limits, 0.0)
        self._chunk = np.empty((_CHUNK, joints))
        self._count = 0
        self._low, self._high = np.full(joints, np.inf), np.full(joints, -np.inf)
        self._change = np.zeros(joints)
        self.least = np.full(joints, np.inf)
        """The least height of a spike ``(joints,)``; infinite until it is known what is usual."""

    @property
    def room(self) -> int:
        """Messages until the chunk is whole."""
        return _CHUNK - self._count

    def add(self, efforts: FloatArray) -> bool:
        """Take the efforts ``(N, joints)`` of messages, at most as many as there is room for. Returns whether the chunk
        was whole, so that something was learned."""
        self._chunk[self._count : self._count + len(efforts)] = efforts
        self._count += len(efforts)
        if self._count < _CHUNK:
            return False
        self._learn(self._chunk)
        self._count = 0
        return True

    def _learn(self, efforts: FloatArray) -> None:
        """Learn the range and the largest change, of the joints whose efforts are all measured."""
        ends = np.sort(efforts, axis=0)[[_TAIL, -1 - _TAIL]]
        change = np.sort(np.abs(np.diff(efforts, axis=0)), axis=0)[-1 - _TAIL]
        measured = ~np.isnan(efforts).any(axis=0)
        self._low = np.where(measured, np.minimum(self._low, ends[0]), self._low)
        self._high = np.where(measured, np.maximum(self._high, ends[1]), self._high)
        self._change = np.where(measured, np.maximum(self._change, change), self._change)
        height = np.maximum(_IN_RANGE * (self._high - self._low), _IN_CHANGES * self._change)
        self.least = np.where(np.isfinite(self._low), np.maximum(height, self._limit), np.inf)


class SaturationDetector:
    """Learns the largest effort of every joint, and how long smaller ones stay the same.

    Rounding keeps a slow curve at its largest, too: -t^2 that just reaches the top level, of depth 1, stays on it for
    2 sqrt(1), and on the level below for sqrt(2) - 1, 4.8 times as short. One that is nearly always at its largest is
    not saturated but constant, as friction at constant speed. A coarse or noiseless sensor is mistaken for a saturated
    one when, after a jump, it shows the same during a long acceleration, larger than ever before.
    """

    def __init__(self, joints: int) -> None:
        self._joints = joints
        self._largest = np.full(joints, np.finfo(np.float64).tiny)  # so zeros are never the largest
        self._messages = 0
        self._at_largest = np.zeros(joints, dtype=np.int64)  # of the messages so far
        self._held = np.zeros(joints, dtype=np.int64)  # messages in which a smaller effort stayed the same
        self.restart()

    def restart(self) -> None:
        """Begin anew, as a clock was set back. What was learned is kept."""
        self._stamp, self._last = 0, np.full(self._joints, np.nan)  # of the last message
        self._largest_since = np.zeros(self._joints, dtype=np.int64)
        self._last_below = np.full(self._joints, self._messages)  # number of the last message with a smaller effort
        self._begun = np.full(self._joints, self._messages)  # since when efforts have been the same
        self._moved = np.zeros(self._joints, dtype=np.bool_)  # while its effort has been the largest

    def saturated(self, stamps: IntArray, effort: FloatArray, velocity: FloatArray, moving: BoolArray) -> BoolArray:
        """Take N messages.

        Args:
            stamps: ``(N,)`` [ns].
            effort: ``(N, joints)``, NaN where it is not measured; so is ``velocity``.
            velocity: ``(N, joints)``.
            moving: ``(N,)`` whether the robot moves.

        Returns:
            ``(N, joints)`` which efforts are saturated.
        """
        size, last = np.abs(effort), np.vstack([self._last, effort[:-1]])
        numbers = np.broadcast_to(self._messages + 1 + np.arange(len(stamps))[:, None], size.shape)
        sizes = np.vstack([self._largest, size])
        if not self._stamp:  # the first one is not learned from
            sizes[1] = np.nan
        records = np.fmax.accumulate(sizes)
        record, grown = records[1:], records[1:] > records[:-1]
        largest: BoolArray = size == record
        below = ~largest
        last_below = _latest(np.where(below, numbers, np.where(grown, numbers - 1, -1)), self._last_below)
        ended = np.logical_or.accumulate(below | grown)  # what was the largest before these messages
        since = np.concatenate([[self._stamp], stamps])[np.maximum(last_below - self._messages, 0)]
        since = np.where(ended, since, self._largest_since)
        moves = np.where(largest & ~(np.abs(velocity) < STILL), numbers, -1)
        moved = (_latest(moves, np.full(self._joints, -1)) > last_below) | (self._moved & ~ended)
        count = self._at_largest + np.cumsum(largest, axis=0)
        held = self._learn_held(numbers, effort != last, grown | (np.abs(last) < record), moving[:, None])
        longest = _LONG * np.maximum(1, held)  # that rounding could explain
        found: BoolArray = (held > 0) & (numbers - last_below >= longest) & moved & moving[:, None]
        found &= (count < _MOSTLY * numbers) & (1e-9 * (stamps[:, None] - since) >= LONGEST_SAME)
        self._stamp, self._last = int(stamps[-1]), effort[-1].copy()
        self._messages += len(stamps)
        self._largest = record[-1]
        self._last_below, self._largest_since = last_below[-1], since[-1]
        self._moved, self._at_largest = moved[-1], count[-1]
        return found

    def _learn_held(self, numbers: IntArray, new: BoolArray, smaller: BoolArray, moving: BoolArray) -> IntArray:
        """Learn for how many messages efforts stay the same though they are not the largest: those of a driver that
        renews them seldom do.

        Args:
            numbers: of the messages ``(N, joints)``.
            new: whether efforts are others than those before ``(N, joints)``.
            smaller: whether those before were not the largest ``(N, joints)``.
            moving: ``(N, 1)`` whether the robot moves.

        Returns:
            ``(N, joints)`` the most messages so far.
        """
        begun = _latest(np.where(new | ~moving, numbers, -1), self._begun)
        begun_before = np.vstack([self._begun, begun[:-1]])
        counts = np.where(new & moving & smaller, numbers - begun_before, 0)
        held = _latest(counts, self._held)
        self._begun, self._held = begun[-1], held[-1]
        return held


def _latest(numbers: IntArray, before: IntArray) -> IntArray:
    """The largest number so far ``(N, joints)``."""
    latest: IntArray = np.maximum(np.maximum.accumulate(numbers), before)
    return latest
