"""Faults of effort numbers over many messages: spikes, saturated, held, coarse, dead band, overflowing, copied."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from geomid_ros.model.samples import REST_SPEED
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.settings import CLEAR_RATIO, LONGEST_SAME
from geomid_ros.types import BoolArray, FloatArray, IntArray

_CHUNK = 128  # messages of a chunk
_TAIL = 6  # outliers of a chunk, at either end, that are ignored
_IN_RANGE, _IN_CHANGES, _IN_LIMIT = 1.5, 8.0, 0.02  # times the range of efforts, their changes, and the URDF's limit
_LONG = 6  # messages at least, and multiple of the longest time that a smaller effort stayed the same
_MOSTLY = 0.75  # largest fraction of messages in which a saturated effort is at its largest


class SpikeHeights:
    """Learns the least height of spikes from chunks of messages; it changes only with a complete chunk."""

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
        """Least height of a spike ``(joints,)``; infinite until typical efforts are known."""

    @property
    def room(self) -> int:
        """Number of messages that complete the chunk."""
        return _CHUNK - self._count

    def add(self, efforts: FloatArray) -> bool:
        """Take the efforts ``(N, joints)`` of messages, at most as many as there is room for. Return True if they
        completed the chunk, so that something was learned."""
        self._chunk[self._count : self._count + len(efforts)] = efforts
        self._count += len(efforts)
        if self._count < _CHUNK:
            return False
        self._learn(self._chunk)
        self._count = 0
        return True

    def _learn(self, efforts: FloatArray) -> None:
        """Learn the range and the largest change for joints whose efforts are all measured."""
        ends = np.sort(efforts, axis=0)[[_TAIL, -1 - _TAIL]]
        change = np.sort(np.abs(np.diff(efforts, axis=0)), axis=0)[-1 - _TAIL]
        measured = ~np.isnan(efforts).any(axis=0)
        self._low = np.where(measured, np.minimum(self._low, ends[0]), self._low)
        self._high = np.where(measured, np.maximum(self._high, ends[1]), self._high)
        self._change = np.where(measured, np.maximum(self._change, change), self._change)
        height = np.maximum(_IN_RANGE * (self._high - self._low), _IN_CHANGES * self._change)
        self.least = np.where(np.isfinite(self._low), np.maximum(height, self._limit), np.inf)


class SaturationDetector:
    """Learns the largest effort of every joint, and for how long smaller efforts stay constant.

    Rounding also keeps a slow curve at its largest value: -t^2 that just reaches the top level, of depth 1, stays on it
    for 2 sqrt(1), and on the level below for sqrt(2) - 1, 4.8 times shorter. An effort that is nearly always at its
    largest is not saturated but constant, as friction at constant speed. A coarse or noiseless sensor is mistaken for a
    saturated one if, after a jump, it is constant during a long acceleration, and larger than ever before.
    """

    def __init__(self, joints: int) -> None:
        self._joints = joints
        self._largest = np.full(joints, np.finfo(np.float64).tiny)  # so that zeros are never the largest
        self._messages = 0
        self._at_largest = np.zeros(joints, dtype=np.int64)  # number of messages at the largest effort so far
        self._held = np.zeros(joints, dtype=np.int64)  # longest run of messages with a constant smaller effort
        self.restart()

    def restart(self) -> None:
        """Restart after a clock was set or positions leapt. What was learned is kept."""
        self._stamp, self._last = 0, np.full(self._joints, np.nan)  # of the last message
        self._begun = np.full(self._joints, self._messages)  # number of the message since which efforts are constant
        self._since = np.zeros(self._joints, dtype=np.int64)  # stamp of the message before it
        self._moved = np.full(self._joints, -1)  # number of the last message in which the joint moved at its largest

    def saturated(self, stamps: IntArray, effort: FloatArray, velocity: FloatArray, moving: BoolArray) -> BoolArray:
        """Take N messages, and find efforts that stay at their largest for longer than rounding explains, while their
        joint moves.

        Args:
            stamps: ``(N,)`` [ns].
            effort: ``(N, joints)``, NaN where it is not measured, like ``velocity``.
            velocity: ``(N, joints)``.
            moving: ``(N,)`` True if the robot moves.

        Returns:
            ``(N, joints)`` True for saturated efforts.
        """
        numbers, moving = np.arange(1, len(stamps) + 1)[:, None] + self._messages, moving[:, None]
        size = np.abs(effort)
        last, sizes = np.concatenate([self._last[None], size[:-1]]), np.concatenate([self._largest[None], size])
        if not self._stamp:  # the first message is not learned from
            sizes[1] = np.nan
        records, new = np.fmax.accumulate(sizes), size != last
        record, largest = records[1:], size == records[1:]
        begun = _latest(np.where(new | ~moving, numbers, -1), self._begun)
        # Efforts below the largest stay constant, too, if the driver seldom renews them.
        smaller = (record > records[:-1]) | (last < record)
        lengths = numbers - np.concatenate([self._begun[None], begun[:-1]])
        held = _latest(np.where(new & moving & smaller, lengths, 0), self._held)
        moved = _latest(np.where(largest & ~(np.abs(velocity) < REST_SPEED), numbers, -1), self._moved)
        before = np.concatenate([[self._stamp], stamps])[np.maximum(begun - self._messages - 1, 0)]
        since = np.where(begun > self._messages, before, self._since)
        count = self._at_largest + np.cumsum(largest, axis=0)
        result: BoolArray = moving & largest & (moved >= begun) & (count < _MOSTLY * numbers)
        result &= (held > 0) & (numbers - begun >= _LONG * np.maximum(1, held) - 1)
        result &= 1e-9 * (stamps[:, None] - since) >= LONGEST_SAME
        self._stamp, self._last, self._largest, self._held = int(stamps[-1]), size[-1], record[-1], held[-1]
        self._begun, self._since, self._moved, self._at_largest = begun[-1], since[-1], moved[-1], count[-1]
        self._messages += len(stamps)
        return result


def _latest(numbers: IntArray, before: IntArray) -> IntArray:
    """Largest number so far ``(N, joints)``."""
    latest: IntArray = np.maximum(np.maximum.accumulate(numbers), before)
    return latest


_FIRST, _MOST = 512, 16384  # messages of a window: a quarter more each time, up to the most
_SMALL = 0.05  # fraction of messages, and of a range
_MANY, _OVERFLOWS = 10, 3  # least number of changes, and of overflows in either direction
_SENTENCES = {
    "held": "change only every {:.1g} s and repeat the same value in between",
    "zero": "drop to exactly zero and return abruptly: a dead band, or a drive switched off or braked",
    "overflow": "jump from one end of their range to the other: integer overflow",
    "copied": "are identical: one is a copy of another",
    "coarse": "come in steps of a quarter or more of their variation: smaller changes are not resolved",
}


class EffortFaultDetector:
    """Checks the efforts of J joints over many messages, and reports each fault once."""

    def __init__(self, joints: Sequence[str], turning: BoolArray, note: Callable[[str], None]) -> None:
        """
        Args:
            joints: their names.
            turning: ``(J,)`` True for revolute joints: two fingers of a gripper may have the same effort.
            note: receives faults of efforts, as an error of the driver if they make efforts doubtful.
        """
        self._joints, self._turning, self._note = tuple(joints), turning, note
        self._kept: list[tuple[IntArray, FloatArray, FloatArray]] = []
        self._due = self._room = _FIRST  # messages of the window, and how many are still to come
        self._before = {kind: np.zeros(len(joints), dtype=np.bool_) for kind in _SENTENCES}
        self._reported = dict(self._before)

    def add(self, stamps: IntArray, positions: FloatArray, efforts: FloatArray) -> None:
        """Take used messages.

        Args:
            stamps: ``(N,)`` [ns].
            positions: ``(N, J)``.
            efforts: ``(N, J)``, NaN where not measured.
        """
        while len(stamps):
            room = self._room
            self._kept.append((stamps[:room], positions[:room], efforts[:room]))
            self._room -= len(stamps[:room])
            if not self._room:
                self._judge()
            stamps, positions, efforts = stamps[room:], positions[room:], efforts[room:]

    def _judge(self) -> None:
        """Check the window. Report faults that were found twice in a row, once for each joint."""
        stamps, positions, efforts = (np.concatenate(parts) for parts in zip(*self._kept, strict=True))
        faults, renewal_periods = effort_faults(stamps, positions, efforts, self._turning)
        for kind, affected in faults.items():
            joints = affected & self._before[kind] & ~self._reported[kind]
            self._reported[kind] = self._reported[kind] | joints
            if joints.any():
                who = "all joints" if joints.all() else ", ".join(repr(self._joints[j]) for j in np.flatnonzero(joints))
                sentence = f"efforts of {who} {_SENTENCES[kind].format(np.median(renewal_periods[joints]))}"
                self._note(Reason(sentence, "told") if kind == "coarse" else driver_error(sentence))
        self._before = faults
        kept = self._due if self._due < _MOST else 0
        self._kept = [(stamps[:kept], positions[:kept], efforts[:kept])]
        self._due = min(5 * self._due // 4, _MOST)
        self._room = self._due - kept


def effort_faults(
    stamps: IntArray, positions: FloatArray, efforts: FloatArray, turning: BoolArray
) -> tuple[dict[str, BoolArray], FloatArray]:
    """Find the faults of efforts: at most one for each joint, besides "copied".

    Args:
        stamps: ``(N,)`` [ns].
        positions: ``(N, J)``.
        efforts: ``(N, J)``, NaN where not measured.
        turning: ``(J,)`` True for revolute joints.

    Returns:
        The affected joints ``(J,)`` by kind of fault; and the mean time between changes [s] ``(J,)``.
    """
    measured = np.isfinite(efforts)
    efforts = _held(efforts, measured)  # any other fill value would be a step that no sensor has
    size, std, span = np.abs(efforts), np.std(efforts, axis=0), np.ptp(efforts, axis=0)
    change, jumps = np.abs(np.diff(efforts, axis=0)), np.diff(size == 0.0, axis=0)
    count = np.count_nonzero(jumps, axis=0)
    typical, jumped = _mean(change, (change > 0.0) & ~jumps), _mean(change, jumps)
    step = np.min(change, axis=0, where=change > 0.0, initial=np.inf)
    many = (np.count_nonzero(change, axis=0) >= _MANY) & (std > 0.0)
    coarse = many & (CLEAR_RATIO * step > std)
    fine = many & ~coarse

    period = 1e-9 * float(np.median(np.diff(stamps)))
    moving = np.abs(np.diff(positions, axis=0)) > REST_SPEED * period
    renewed = np.sum(moving & (change > 0.0), axis=0)
    renewal_period = period * np.sum(moving, axis=0) / np.maximum(renewed, 1)
    repeats = 2 * renewed <= np.sum(moving, axis=0)  # at least once in between
    held = fine & repeats & (renewed >= _MANY) & (renewal_period > LONGEST_SAME) & (typical > CLEAR_RATIO * step)

    least = np.min(size, axis=0, where=size > 0.0, initial=np.inf)
    dead = (np.mean(size == 0.0, axis=0) > _SMALL) & (CLEAR_RATIO * least > std)
    zero = fine & ~held & (dead | ((count >= _MANY) & (jumped > CLEAR_RATIO * typical)))

    relative = (efforts - np.min(efforts, axis=0)) / np.where(span > 0.0, span, 1.0)
    low, high = relative < _SMALL, relative > 1.0 - _SMALL
    both = [np.sum(one[:-1] & other[1:], axis=0) for one, other in ((low, high), (high, low))]
    over = fine & ~held & ~zero & (typical < _SMALL * span) & (np.minimum(*both) >= _OVERFLOWS)
    over &= span < 2.0 * CLEAR_RATIO * std  # else a few spikes make the range

    copied = np.zeros(len(span), dtype=np.bool_)
    few = np.where(size > 0.0, efforts, np.nan)[: int(_SMALL * len(efforts)) + 1].T  # copies agree at least once here
    for one, other in np.argwhere(np.any(few[:, None] == few, axis=2) & np.outer(fine & turning, fine & turning)):
        if one < other and np.mean((size[:, one] > 0.0) & (efforts[:, one] == efforts[:, other])) > 1.0 - _SMALL:
            copied[[one, other]] = True
    return {"held": held, "zero": zero, "overflow": over, "copied": copied, "coarse": coarse}, renewal_period


def _held(efforts: FloatArray, measured: BoolArray) -> FloatArray:
    """Efforts ``(N, J)``; gaps have the value before, or the first one, or zero if none is measured."""
    places = np.where(measured, np.arange(len(efforts))[:, None], np.argmax(measured, axis=0))
    result = np.take_along_axis(efforts, np.maximum.accumulate(places, axis=0), axis=0)
    return np.where(np.any(measured, axis=0), result, 0.0)


def _mean(values: FloatArray, selected: BoolArray) -> FloatArray:
    """Means ``(J,)`` of the selected ``values (N, J)``; zero where none is selected."""
    return np.asarray(np.sum(values, axis=0, where=selected) / np.maximum(np.sum(selected, axis=0), 1))
