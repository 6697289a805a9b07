"""What the numbers of efforts look like over many messages: held, coarse, cut about zero, overflowing, copied."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.limits import STANDING
from geomid_ros.signals.usual_efforts import CHUNK
from geomid_ros.types import BoolArray, FloatArray, IntArray

_FEWEST_CHUNKS = 4  # before anything is told
_LONGEST_HELD = 0.05  # [s] what is renewed at 20 Hz or more is hardly late
_HELD = 4.0  # smallest changes, that one is on average: a coarse sensor's are one
_COARSE = 0.25  # standard deviations
_MANY = 10  # changes, at least
_ZEROS, _GAP = 0.05, 0.2  # of the messages; standard deviations about zero without any number but zero
_BRAKED = 4.0  # usual changes, that one from or to zero is on average
_FILLED = 8.0  # standard deviations: a range that efforts fill
_ENDS, _OVERFLOWS = 0.05, 3  # of the range: a usual change is less; overflows in either direction
_ALIKE, _EVERY = 0.95, 8  # of the messages; looked at
_SENTENCES = {
    "held": "come only every {:.1g} s, and are the same numbers in between",
    "zero": "fall to exactly zero, and rise again, at once: a dead band, or a drive switched off or braked",
    "overflow": "jump from one end of their range to the other: their numbers overflow",
    "copied": "are the same numbers: one of them is a copy",
    "coarse": "come in steps of a quarter or more of their variation: only what is larger is seen of the motion",
}


class EffortHabits:
    """Learns from chunks of messages with efforts of J joints, and tells once what is peculiar about them."""

    def __init__(self, joints: Sequence[str], turning: BoolArray, note: Callable[[str], None]) -> None:
        """
        Args:
            joints: their names.
            turning: ``(J,)`` which are revolute: two fingers of a gripper may have one effort.
            note: told what is peculiar about efforts, as an error of the driver where it makes them doubtful.
        """
        self._joints, self._turning = tuple(joints), turning
        self._note = note
        count = len(joints)
        self._stamps = np.zeros(CHUNK, dtype=np.int64)
        self._positions, self._efforts = np.zeros((CHUNK, count)), np.zeros((CHUNK, count))
        self._count = self._chunks = 0
        self._time, self._renewed = np.zeros(count), np.zeros(count)  # [s], and changes, while the joint moves
        self._messages, self._sum, self._squares, self._zeros = (np.zeros(count) for _ in range(4))
        self._first: FloatArray | None = None
        self._low, self._high = np.full(count, np.inf), np.full(count, -np.inf)
        self._least = np.full(count, np.inf)  # size that is not zero
        self._step = np.full(count, np.inf)  # smallest change
        self._changes, self._way = np.zeros(count), np.zeros(count)  # their number and sum
        self._jumps, self._jumped = np.zeros(count), np.zeros(count)  # those from and to zero
        self._overflows = np.zeros((2, count))
        self._alike = np.zeros((count, count))
        self._before: dict[str, BoolArray] = {}
        self._told: dict[str, BoolArray] = {}

    def add(self, stamps: IntArray, positions: FloatArray, efforts: FloatArray) -> None:
        """Take messages that are used.

        Args:
            stamps: ``(N,)`` [ns].
            positions: ``(N, J)``.
            efforts: ``(N, J)``, NaN where not measured.
        """
        taken = 0
        while taken < len(stamps):
            part = slice(taken, taken + CHUNK - self._count)
            end = self._count + len(stamps[part])
            self._stamps[self._count : end] = stamps[part]
            self._positions[self._count : end] = positions[part]
            self._efforts[self._count : end] = efforts[part]
            taken += end - self._count
            self._count = end
            if end == CHUNK:
                self._learn(self._efforts)
                self._count = 0

    @property
    def _range(self) -> FloatArray:
        """From the smallest effort to the largest ``(J,)``; zero where none is measured."""
        measured = np.isfinite(self._low)
        nothing = np.zeros(len(measured))
        return np.asarray(np.subtract(self._high, self._low, out=nothing, where=measured))

    def _learn(self, efforts: FloatArray) -> None:
        known = np.isfinite(efforts)
        self._chunks += 1
        self._first = np.where(known[0], efforts[0], 0.0) if self._first is None else self._first
        off = np.where(known, efforts - self._first, 0.0)
        size, change = np.abs(efforts), np.abs(np.diff(efforts, axis=0))
        self._messages += np.sum(known, axis=0)
        self._sum, self._squares = self._sum + np.sum(off, axis=0), self._squares + np.sum(off**2, axis=0)
        self._zeros += np.sum(size == 0.0, axis=0)
        self._low = np.fmin(self._low, np.fmin.reduce(efforts, axis=0))
        self._high = np.fmax(self._high, np.fmax.reduce(efforts, axis=0))
        self._least = np.fmin(self._least, np.fmin.reduce(np.where(size > 0.0, size, np.inf), axis=0))
        self._step = np.fmin(self._step, np.fmin.reduce(np.where(change > 0.0, change, np.inf), axis=0))
        at_zero = np.diff((size == 0.0).astype(np.int8), axis=0) != 0
        jumps, changes = at_zero & (change > 0.0), ~at_zero & (change > 0.0)
        self._jumps, self._jumped = self._jumps + np.sum(jumps, axis=0), self._jumped + _sum(change, jumps)
        self._changes, self._way = self._changes + np.sum(changes, axis=0), self._way + _sum(change, changes)
        period = 1e-9 * float(np.median(np.diff(self._stamps)))
        moving = np.abs(np.diff(self._positions, axis=0)) > STANDING * period
        self._time, self._renewed = (
            self._time + period * np.sum(moving, axis=0),
            self._renewed + np.sum(moving & (change > 0.0), axis=0),
        )
        margin = _ENDS * self._range
        up, down = efforts > self._high - margin, efforts < self._low + margin
        self._overflows += [np.sum(up[:-1] & down[1:], axis=0), np.sum(down[:-1] & up[1:], axis=0)]
        seldom = efforts[::_EVERY]
        self._alike += np.sum((seldom[:, :, None] == seldom[:, None]) & (seldom[:, :, None] != 0.0), axis=0)
        if self._chunks >= _FEWEST_CHUNKS:
            self._tell()

    def _kinds(self) -> dict[str, BoolArray]:
        """Which joints are concerned ``(J,)``, by the kind of what is wrong; each joint by one thing alone."""
        count = np.maximum(self._messages, 1.0)
        spread = np.sqrt(np.maximum(self._squares / count - (self._sum / count) ** 2, 0.0))
        usual, full = self._way / np.maximum(self._changes, 1.0), self._range
        many = (self._changes + self._jumps >= _MANY) & (spread > 0.0)
        coarse = many & (self._step > _COARSE * spread)
        fine = many & ~coarse
        held = (
            fine
            & (self._renewed >= _MANY)
            & (self._time > _LONGEST_HELD * self._renewed)
            & (usual > _HELD * self._step)
        )
        share = self._zeros / count
        dead = (share > _ZEROS) & (self._least > _GAP * spread)
        braked = (self._jumps >= _MANY) & (self._jumped > _BRAKED * usual * self._jumps)
        zero = fine & ~held & (dead | braked)
        over = fine & ~held & ~zero & (usual < _ENDS * full) & np.all(self._overflows >= _OVERFLOWS, axis=0)
        over &= full < _FILLED * spread  # else it is a few spikes that make the range
        same = np.triu(self._alike > _ALIKE * self._messages / _EVERY, 1) & np.outer(fine, fine)
        same &= np.outer(self._turning, self._turning)
        copied = same.any(axis=0) | same.any(axis=1)
        return {"held": held, "zero": zero, "overflow": over, "copied": copied, "coarse": coarse}

    def _tell(self) -> None:
        """Tell of each joint once what is found twice in a row."""
        found = self._kinds()
        for kind, now in found.items():
            told = self._told.get(kind, np.zeros_like(now))
            joints = now & self._before.get(kind, told) & ~told
            if joints.any():
                self._told[kind] = told | joints
                every = np.median(self._time[joints] / np.maximum(self._renewed[joints], 1.0))
                who = "all joints" if joints.all() else ", ".join(repr(self._joints[j]) for j in np.flatnonzero(joints))
                sentence = f"efforts of {who} {_SENTENCES[kind].format(every)}"
                self._note(Reason(sentence, "told") if kind == "coarse" else driver_error(sentence))
        self._before = found


def _sum(values: FloatArray, which: BoolArray) -> FloatArray:
    return np.asarray(np.sum(np.where(which, values, 0.0), axis=0))
