"""Joint messages: numbers in the robot's order of joints, and whether its efforts are plausible."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.joint_names import missing_joint
from geomid_ros.signals.messages import JointMessage
from geomid_ros.signals.saturation import STANDING, SaturationDetector
from geomid_ros.types import BoolArray, FloatArray, IntArray

DRIVER_ERROR = "driver error: "
"""Reasons begin with this when the driver fills in its messages wrongly."""
_LARGEST_NUMBER = 1e9  # in SI units
_SILENT = 1_000_000_000  # [ns] behind the other parts
_MOST_WAITING = 10_000  # messages of a part, while another is silent

Part: TypeAlias = tuple[str, ...]
"""The robot's joints that come together, in the robot's order."""


class RejectedError(Exception):
    """A message that cannot be used; the text is the reason that is counted."""


def plausible(values: FloatArray) -> BoolArray:
    """False for NaN, infinity and numbers that no robot measures."""
    return np.abs(values) < _LARGEST_NUMBER


class JointReader:
    """Checks joint messages, in the order of their stamps, and brings them into the robot's order of joints.

    An effort that fails for less than ``max_gap`` costs the message, one that fails for longer its joint's equation.
    """

    def __init__(
        self, joints: Sequence[str], gains: FloatArray, continuous: BoolArray, max_gap: int, note: Callable[[str], None]
    ) -> None:
        """
        Args:
            joints: the robot's, in its order.
            gains: ``(joints,)`` factors of efforts.
            continuous: ``(joints,)`` which have no end: their positions may jump by whole turns.
            max_gap: [ns].
            note: is told of peculiarities.
        """
        self._joints = tuple(joints)
        self._gains = gains
        self._continuous = continuous
        self._max_gap = max_gap
        self._note = note
        self._noted: set[str] = set()
        self._names: tuple[str, ...] = ()
        self._order = np.zeros(len(joints), dtype=np.int64)
        self._saturation = SaturationDetector(len(joints))
        self.restart()

    def restart(self) -> None:
        """Begin anew, as a clock was set back."""
        self._stamp = 0
        self._last: FloatArray | None = None  # positions, velocities and efforts of the last message that was good
        self._speed = 0.0
        self._made_up = True  # until an effort is seen that is not zero
        self._effort_stamps = np.zeros(len(self._joints), dtype=np.int64)
        self._saturation.restart()

    @property
    def stamp(self) -> int:
        """Of the last message that was good [ns]; 0 before."""
        return self._stamp

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose equations are left out, as their efforts have failed for long."""
        if not self._stamp:
            return ()
        lost = (self._effort_stamps == 0) | (self._stamp - self._effort_stamps > self._max_gap)
        return tuple(joint for joint, gone in zip(self._joints, lost, strict=True) if gone)

    def read(self, message: JointMessage) -> FloatArray:
        """What a message says, in the robot's order of joints.

        Returns:
            Positions, velocities and efforts ``(3 joints,)``, NaN where an effort or a velocity is not measured.

        Raises:
            RejectedError: the message cannot be used.
        """
        stamp, names, rows = message.stamp, message.names, (message.position, message.velocity, message.effort)
        order = self._order_of(names)
        for kind, values in zip(("position", "velocity", "effort"), rows, strict=True):
            if len(values) not in ((len(names),) if kind == "position" else (0, len(names))):
                raise RejectedError(f"{DRIVER_ERROR}{kind} has {len(values)} entries for {len(names)} names")
        if not len(message.velocity):
            self._note_once("no velocities: positions are differentiated")
        vector = np.full((3, len(order)), np.nan)
        for row, values in enumerate(rows):
            if len(values):
                vector[row] = values[order]
        vector[2] *= self._gains
        wild = ~plausible(vector)
        if wild[0].any():
            raise RejectedError(f"position of '{self._joints[int(np.argmax(wild[0]))]}' not finite")
        vector[wild] = np.nan
        self._unwind(vector[0])
        if self._frozen(stamp, vector):
            raise RejectedError("frozen: all numbers are those of the message before, though the robot moves")
        self._check_effort(stamp, vector)
        self._stamp, self._last = stamp, vector
        return vector.ravel()

    def _order_of(self, names: tuple[str, ...]) -> IntArray:
        """The places of the robot's joints among a message's names. Most messages have those of the one before."""
        if not names:
            raise RejectedError(DRIVER_ERROR + "no joint names")
        if self._names != names:
            index = {name: place for place, name in enumerate(names)}
            if len(index) != len(names):
                twice = next(name for place, name in enumerate(names) if index[name] != place)
                raise RejectedError(f"{DRIVER_ERROR}joint '{twice}' is named twice")
            if missing := missing_joint(self._joints, names):
                raise RejectedError(missing)
            extra = next((name for name in names if name not in self._joints), None)
            if extra is not None:
                self._note_once(f"joint '{extra}' is not one of the robot's: passed over")
            self._names = names
            self._order = np.array([index[joint] for joint in self._joints], dtype=np.int64)
        return self._order

    def _note_once(self, remark: str) -> None:
        if remark not in self._noted and len(self._noted) < len(self._joints) + 10:
            self._noted.add(remark)
            self._note(remark)

    def _unwind(self, position: FloatArray) -> None:
        """Add whole turns to the positions of continuous joints, so that they do not jump."""
        if self._last is not None and self._continuous.any():
            turns = np.where(self._continuous, np.round((self._last[0] - position) / (2.0 * np.pi)), 0.0)
            position += 2.0 * np.pi * turns

    def _frozen(self, stamp: int, vector: FloatArray) -> bool:
        """Whether no number has changed, though by velocities, or else by the positions before, the robot moves."""
        last = self._last
        # Positions first, which are numbers: to compare what may be NaN takes many times as long.
        if last is None or not (vector[0] == last[0]).all() or not np.array_equal(vector, last, equal_nan=True):
            self._speed = self._speed_at(stamp, vector)
            return False
        return self._speed > STANDING

    def _speed_at(self, stamp: int, vector: FloatArray) -> float:
        speed = float(np.fmax.reduce(np.abs(vector[1]), initial=np.nan))
        if np.isfinite(speed):
            return speed
        if self._last is None:
            return 0.0
        return float(np.max(np.abs(vector[0] - self._last[0]), initial=0.0)) / (1e-9 * (stamp - self._stamp))

    def _check_effort(self, stamp: int, vector: FloatArray) -> None:
        """Leave out efforts that have failed for long. Raises RejectedError for others that fail."""
        effort = vector[2]
        reason = "effort of '{}' missing or not finite"
        if np.all(np.isnan(effort)):
            reason = DRIVER_ERROR + "no effort of '{}' or any other joint"
        if self._zeros(effort):
            effort[:] = np.nan
            reason = DRIVER_ERROR + "effort of '{}' and of all others is zero while the robot moves"
        before = None if self._last is None else (self._stamp, self._last[2])
        saturated = self._saturation.saturated(stamp, effort, vector[1], self._speed > STANDING, before)
        if np.any(saturated):
            effort[saturated] = np.nan
            reason = "effort of '{}' saturated: for long the same, and never larger"
        measured = np.isfinite(effort)
        lost = np.flatnonzero(~measured & (self._effort_stamps > 0) & (stamp - self._effort_stamps <= self._max_gap))
        if len(lost):
            raise RejectedError(reason.format(self._joints[int(lost[0])]))
        self._effort_stamps[measured] = stamp

    def _zeros(self, effort: FloatArray) -> bool:
        """Whether all efforts are exactly zero, and have been since the robot moved: the driver has no sensor."""
        self._made_up = not np.any(effort) and (self._made_up or self._speed > STANDING)
        return self._made_up


class JointParts:
    """Joins messages of several publishers, each with some of the joints, at the stamps that all have reached.

    Where the parts' stamps differ, two messages of a part that are no further apart than ``max_gap`` [ns] are
    interpolated linearly.
    """

    def __init__(self, joints: Sequence[str], max_gap: int, make_reader: Callable[[Part], JointReader]) -> None:
        self._joints = tuple(joints)
        self._max_gap = max_gap
        self._make_reader = make_reader
        self.readers: dict[Part, JointReader] = {}
        self.restart()

    def restart(self) -> None:
        """Begin anew, as a clock was set back."""
        for reader in self.readers.values():
            reader.restart()
        self._waiting: dict[Part, deque[tuple[int, FloatArray]]] = {part: deque() for part in self.readers}
        self._last = 0

    @property
    def silent(self) -> tuple[str, ...]:
        """The joints of which nothing has come for long, while something came of others."""
        newest = max((reader.stamp for reader in self.readers.values()), default=0)
        heard = [joint for part, reader in self.readers.items() if newest - reader.stamp <= _SILENT for joint in part]
        return tuple(joint for joint in self._joints if joint not in heard) if newest else ()

    def part(self, names: Sequence[str]) -> Part:
        """The part of a message with these names. Raises RejectedError if it is of several, or of none."""
        part = tuple(joint for joint in self._joints if joint in set(names))
        if part in self.readers:
            return part
        if not part:
            raise RejectedError("none of the robot's joints" if names else DRIVER_ERROR + "no joint names")
        known = next((joint for other in self.readers for joint in other if joint in part), None)
        if known is not None:
            raise RejectedError(f"{DRIVER_ERROR}joint '{known}' comes with others than before")
        self.readers = {**self.readers, part: self._make_reader(part)}
        self._waiting[part] = deque()
        return part

    def add(self, part: Part, stamp: int, values: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Take a part's numbers ``(3 joints of it,)``. Yields stamps and numbers ``(3 joints,)`` of the whole."""
        waiting = self._waiting[part]
        waiting.append((stamp, values.reshape(3, -1)))
        if len(waiting) > _MOST_WAITING:
            waiting.popleft()
        if sum(map(len, self._waiting)) < len(self._joints) or not all(self._waiting.values()):
            return
        common = min(entries[-1][0] for entries in self._waiting.values())
        begin = max(entries[0][0] for entries in self._waiting.values())
        if common <= self._last or common < begin:
            return
        self._last = common
        for entries in self._waiting.values():
            while len(entries) > 1 and entries[1][0] <= common:
                entries.popleft()
        if all(self._is_between(entries, common) for entries in self._waiting.values()):
            yield common, self._at(common)

    def _is_between(self, entries: deque[tuple[int, FloatArray]], stamp: int) -> bool:
        return entries[0][0] == stamp or entries[1][0] - entries[0][0] <= self._max_gap

    def _at(self, stamp: int) -> FloatArray:
        whole = np.empty((3, len(self._joints)))
        for part, entries in self._waiting.items():
            whole[:, [self._joints.index(joint) for joint in part]] = _between(entries, stamp)
        return whole.ravel()


def _between(entries: deque[tuple[int, FloatArray]], stamp: int) -> FloatArray:
    first, before = entries[0]
    if first == stamp:
        return before
    second, after = entries[1]
    return before + (stamp - first) / (second - first) * (after - before)
