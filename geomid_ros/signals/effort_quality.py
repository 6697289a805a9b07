"""What the numbers of efforts look like over many messages: held, coarse, cut about zero, overflowing, copied."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from geomid_ros.model.samples import STILL
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.limits import CLEAR, LONGEST_SAME
from geomid_ros.types import BoolArray, FloatArray, IntArray

_FIRST, _MOST = 512, 16384  # messages that are judged together: a quarter more each time, up to the most
_SMALL = 0.05  # share of messages, and of a range
_MANY, _OVERFLOWS = 10, 3  # changes, and overflows in either direction, at least
_SENTENCES = {
    "held": "come only every {:.1g} s, and are the same numbers in between",
    "zero": "fall to exactly zero, and rise again, at once: a dead band, or a drive switched off or braked",
    "overflow": "jump from one end of their range to the other: their numbers overflow",
    "copied": "are the same numbers: one of them is a copy",
    "coarse": "come in steps of a quarter or more of their variation: only what is larger is seen of the motion",
}


class EffortQuality:
    """Collects messages with efforts of J joints, and tells once what is peculiar about them."""

    def __init__(self, joints: Sequence[str], turning: BoolArray, note: Callable[[str], None]) -> None:
        """
        Args:
            joints: their names.
            turning: ``(J,)`` which are revolute: two fingers of a gripper may have one effort.
            note: told what is peculiar about efforts, as an error of the driver where it makes them doubtful.
        """
        self._joints, self._turning, self._note = tuple(joints), turning, note
        self._kept: list[tuple[IntArray, FloatArray, FloatArray]] = []
        self._due = self._room = _FIRST  # messages of the window, and those that are still to come
        self._before = {kind: np.zeros(len(joints), dtype=np.bool_) for kind in _SENTENCES}
        self._told = dict(self._before)

    def add(self, stamps: IntArray, positions: FloatArray, efforts: FloatArray) -> None:
        """Take messages that are used.

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
        """Tell of each joint once what is found twice in a row."""
        stamps, positions, efforts = (np.concatenate(parts) for parts in zip(*self._kept, strict=True))
        found, every = peculiar(stamps, positions, efforts, self._turning)
        for kind, now in found.items():
            joints = now & self._before[kind] & ~self._told[kind]
            self._told[kind] = self._told[kind] | joints
            if joints.any():
                who = "all joints" if joints.all() else ", ".join(repr(self._joints[j]) for j in np.flatnonzero(joints))
                sentence = f"efforts of {who} {_SENTENCES[kind].format(np.median(every[joints]))}"
                self._note(Reason(sentence, "told") if kind == "coarse" else driver_error(sentence))
        self._before = found
        kept = self._due if self._due < _MOST else 0
        self._kept = [(stamps[:kept], positions[:kept], efforts[:kept])]
        self._due = min(5 * self._due // 4, _MOST)
        self._room = self._due - kept


def peculiar(
    stamps: IntArray, positions: FloatArray, efforts: FloatArray, turning: BoolArray
) -> tuple[dict[str, BoolArray], FloatArray]:
    """What is peculiar about efforts, each joint's by one thing alone.

    Args:
        stamps: ``(N,)`` [ns].
        positions: ``(N, J)``.
        efforts: ``(N, J)``, NaN where not measured.
        turning: ``(J,)`` which joints are revolute.

    Returns:
        Which joints are concerned ``(J,)``, by the kind; and the time between changes [s] ``(J,)``.
    """
    measured = np.isfinite(efforts)
    efforts = _held(efforts, measured)  # a number of its own would be a step that no sensor has
    size, spread, whole = np.abs(efforts), np.std(efforts, axis=0), np.ptp(efforts, axis=0)
    change, jumps = np.abs(np.diff(efforts, axis=0)), np.diff(size == 0.0, axis=0)
    count = np.count_nonzero(jumps, axis=0)
    usual, jumped = _mean(change, (change > 0.0) & ~jumps), _mean(change, jumps)
    step = np.min(change, axis=0, where=change > 0.0, initial=np.inf)
    many = (np.count_nonzero(change, axis=0) >= _MANY) & (spread > 0.0)
    coarse = many & (CLEAR * step > spread)
    fine = many & ~coarse

    period = 1e-9 * float(np.median(np.diff(stamps)))
    moving = np.abs(np.diff(positions, axis=0)) > STILL * period
    renewed = np.sum(moving & (change > 0.0), axis=0)
    every = period * np.sum(moving, axis=0) / np.maximum(renewed, 1)
    held = fine & (renewed >= _MANY) & (every > LONGEST_SAME) & (usual > CLEAR * step)

    least = np.min(size, axis=0, where=size > 0.0, initial=np.inf)
    dead = (np.mean(size == 0.0, axis=0) > _SMALL) & (CLEAR * least > spread)
    zero = fine & ~held & (dead | ((count >= _MANY) & (jumped > CLEAR * usual)))

    place = (efforts - np.min(efforts, axis=0)) / np.where(whole > 0.0, whole, 1.0)
    low, high = place < _SMALL, place > 1.0 - _SMALL
    both = [np.sum(one[:-1] & other[1:], axis=0) for one, other in ((low, high), (high, low))]
    over = fine & ~held & ~zero & (usual < _SMALL * whole) & (np.minimum(*both) >= _OVERFLOWS)
    over &= whole < 2.0 * CLEAR * spread  # else it is a few spikes that make the range

    copied = np.zeros(len(whole), dtype=np.bool_)
    few = np.where(size > 0.0, efforts, np.nan)[: int(_SMALL * len(efforts)) + 1].T  # not all of these may differ
    for one, other in np.argwhere(np.any(few[:, None] == few, axis=2) & np.outer(fine & turning, fine & turning)):
        if one < other and np.mean((size[:, one] > 0.0) & (efforts[:, one] == efforts[:, other])) > 1.0 - _SMALL:
            copied[[one, other]] = True
    return {"held": held, "zero": zero, "overflow": over, "copied": copied, "coarse": coarse}, every


def _held(efforts: FloatArray, measured: BoolArray) -> FloatArray:
    """Efforts ``(N, J)``, those before, or the first ones, where they are not measured; zero where none ever are."""
    places = np.where(measured, np.arange(len(efforts))[:, None], np.argmax(measured, axis=0))
    held = np.take_along_axis(efforts, np.maximum.accumulate(places, axis=0), axis=0)
    return np.where(np.any(measured, axis=0), held, 0.0)


def _mean(values: FloatArray, which: BoolArray) -> FloatArray:
    """Means ``(J,)`` of some of ``values (N, J)``, zero where there are none."""
    return np.asarray(np.sum(values, axis=0, where=which) / np.maximum(np.sum(which, axis=0), 1))
