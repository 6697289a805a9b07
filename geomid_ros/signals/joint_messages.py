"""Joint messages: numbers in the robot's order of joints, checks of efforts, and joints of several publishers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from math import tau
from typing import TypeAlias

import numpy as np

from geomid_ros.model.samples import REST_SPEED
from geomid_ros.signals.clocks import MISSED, steps
from geomid_ros.signals.effort_quality import EffortFaultDetector, SaturationDetector
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.message_batch import missing_joint, plausible, without_refusal
from geomid_ros.signals.messages import Block
from geomid_ros.signals.settings import MOST_WAITING
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

_UNLIKE_A_TURN = 0.5  # [rad] a step that is nearer to a whole turn is an artefact of the driver
UNWRAPPED = "jump by whole turns: unwrapped"
SILENT = 1_000_000_000
"""[ns] delay relative to the other parts, above which a part is silent."""

Part: TypeAlias = tuple[str, ...]
"""Joints of one publisher, in the robot's order."""
FROZEN = Reason("frozen: all numbers are those of the message before, though the robot moves", "repeated")


@dataclass(eq=False)
class JointReader:
    """Checks joint messages in the order of their stamps, and converts them to the robot's order of joints.

    If an effort is invalid for less than ``max_gap``, its messages are refused; if for longer, the equation of its
    joint is left out.

    Attributes:
        joints: joints of the robot, in its order.
        gains: ``(joints,)`` factors of efforts.
        continuous: ``(joints,)`` True for joints without limits: their positions may jump by whole turns.
        max_gap: [ns].
        note: receives remarks.
        turning: ``(joints,)`` True for revolute joints: the driver causes steps of a whole turn in their positions.
    """

    joints: tuple[str, ...]
    gains: FloatArray
    continuous: BoolArray
    max_gap: int
    note: Callable[[str], None]
    turning: BoolArray | None = None

    def __post_init__(self) -> None:
        none = np.zeros(len(self.joints), dtype=np.bool_)
        self._wrapped = none if self.turning is None else self.turning & ~self.continuous
        self._noted: set[str] = set()
        self._names: tuple[str, ...] = ()
        self._order = np.zeros(len(self.joints), dtype=np.int64)
        self._saturation = SaturationDetector(len(self.joints))
        self._quality = EffortFaultDetector(self.joints, self.continuous | self._wrapped, self.note)
        self.restart()

    def restart(self) -> None:
        """Restart after a clock was set or positions leapt."""
        self._stamp = 0
        self._last = np.full((3, len(self.joints)), np.inf)  # of the last message, before efforts were checked
        self._raw: FloatArray | None = None  # its positions before turns were added
        self._turns = np.zeros(len(self.joints))  # whole turns that are added
        self._came, self._speed = 0, 0.0  # stamp and speed of the last message
        self._seen = np.zeros(len(self.joints), dtype=np.bool_)  # joints that have had a nonzero effort
        self._made_up = False  # True while all efforts are zero for lack of a sensor
        self._effort_stamps = np.zeros(len(self.joints), dtype=np.int64)
        self._saturation.restart()

    @property
    def stamp(self) -> int:
        """Stamp of the last message that was not frozen [ns]; 0 before."""
        return self._stamp

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Joints whose equations are left out, as their efforts have been invalid for long."""
        if not self._stamp:
            return ()
        lost = (self._effort_stamps == 0) | (self._stamp - self._effort_stamps > self.max_gap)
        return tuple(joint for joint, is_lost in zip(self.joints, lost, strict=True) if is_lost)

    def numbers(self, block: Block) -> tuple[FloatArray, AnyArray]:
        """Read messages, each by itself, into the robot's order of joints.

        Returns:
            Positions, velocities and efforts ``(N, 3, joints)``, NaN where not measured; and for each message ``(N,)``
            the reason why it is unusable by itself, or None.
        """
        count = len(block.stamps)
        vector, refusals = np.full((count, 3, len(self.joints)), np.nan), np.full(count, None)
        if reason := self._set_order(block.names) or _wrong_length(block):
            refusals[:] = reason
            return vector, refusals
        if not block.arrays[1].shape[1]:
            self._note_once("no velocities: positions are differentiated")
        for kind, values in enumerate(block.arrays):
            if values.shape[1]:
                vector[:, kind] = values[:, self._order]
        vector[:, 2] *= self.gains
        good = plausible(vector)
        invalid = ~good[:, 1] & ~np.isnan(vector[:, 1])  # drivers without measured velocities send NaN
        for row in np.flatnonzero(invalid.any(axis=1)):
            refusals[row] = f"velocity of '{self.joints[int(np.argmax(invalid[row]))]}' not finite"
        for row in np.flatnonzero(~good[:, 0].all(axis=1)):
            refusals[row] = f"position of '{self.joints[int(np.argmin(good[row, 0]))]}' not finite"
        vector[~good] = np.nan
        return vector, refusals

    def read(self, stamps: IntArray, numbers: FloatArray) -> tuple[FloatArray, AnyArray]:
        """Check messages against those before them.

        Args:
            stamps: ``(N,)`` [ns], increasing.
            numbers: ``(N, 3, joints)`` as from :meth:`numbers`.

        Returns:
            The numbers of the messages ``(N, 3 joints)``; and for each message ``(N,)`` the reason why it is unusable,
            or None.
        """
        values, refusals = numbers.copy(), np.full(len(stamps), None)
        self._unwind(values[:, 0])
        frozen, speeds = self._frozen(stamps, values)
        refusals[frozen] = FROZEN
        used = np.flatnonzero(~frozen)
        if len(used):
            used_stamps, used_values = stamps[used], values[used]
            self._stamp, self._last = int(used_stamps[-1]), used_values[-1].copy()
            refusals[used] = self._check_effort(used_stamps, used_values, speeds[used] > REST_SPEED)
            values[used] = used_values
            good = without_refusal(refusals)
            self._quality.add(stamps[good], values[good, 0], values[good, 2])
        return values.reshape(len(stamps), -1), refusals

    def _set_order(self, names: tuple[str, ...]) -> str:
        """Find the places of the robot's joints among a message's names. Most messages have the same names as the one
        before. Return why the names are not usable; empty if they are."""
        if not names:
            return driver_error("no joint names")
        if self._names != names:
            index = {name: place for place, name in enumerate(names)}
            if len(index) != len(names):
                duplicate = next(name for place, name in enumerate(names) if index[name] != place)
                return driver_error(f"joint '{duplicate}' is named twice")
            if missing := missing_joint(self.joints, names):
                return missing
            if extra := [name for name in names if name not in self.joints]:
                listing = ", ".join(map(repr, extra))
                self._note_once(Reason(f"ignored, no moving joints of the robot: {listing}", "note"))
            self._names = names
            self._order = np.array([index[joint] for joint in self.joints], dtype=np.int64)
        return ""

    def _note_once(self, remark: str) -> None:
        if remark not in self._noted and len(self._noted) < len(self.joints) + 10:
            self._noted.add(remark)
            self.note(remark)

    def _unwind(self, positions: FloatArray) -> None:
        """Add whole turns to positions that jump by them, for continuous joints and for drivers that wrap."""
        moved = steps(positions, positions[0] if self._raw is None else self._raw)
        self._raw = positions[-1].copy()
        turns = np.rint(moved / tau)
        wraps = self._wrapped & (turns != 0.0) & (np.abs(moved - tau * turns) < _UNLIKE_A_TURN)
        for joint in np.flatnonzero(wraps.any(axis=0)):
            self._note_once(Reason(f"positions of '{self.joints[int(joint)]}' {UNWRAPPED}", "told"))
        added = self._turns - np.cumsum(np.where(self.continuous | wraps, turns, 0.0), axis=0)
        positions += tau * added
        self._turns = added[-1]

    def _frozen(self, stamps: IntArray, numbers: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Find messages in which no number changed although the robot moves, by velocities or else by earlier
        positions; and the speed in each message. Both are ``(N,)``."""
        # Positions first, as they are rarely all equal. Zero efforts are checked elsewhere.
        moved = steps(numbers[:, 0], self._last[0])
        same: BoolArray = ~moved.any(axis=1)
        if same.any():
            now, before = numbers[same], np.concatenate([self._last[None], numbers[:-1]])[same]
            same[same] = ((now == before) | (np.isnan(now) & np.isnan(before))).all(axis=(1, 2)) & now[:, 2].any(axis=1)
        speeds = self._speeds(stamps, numbers[:, 1], moved, same)
        self._came, self._speed = int(stamps[-1]), float(speeds[-1])
        return same & (speeds > REST_SPEED), speeds

    def _speeds(self, stamps: IntArray, velocities: FloatArray, moved: FloatArray, same: BoolArray) -> FloatArray:
        """Largest joint speed in each message ``(N,)``. Where it is not measured, it is derived from the steps
        ``moved (N, J)``; where all numbers are ``same`` as before, that of the message before is used."""
        speeds: FloatArray = np.fmax.reduce(np.abs(velocities), axis=1, initial=np.nan)
        farthest = np.max(np.abs(moved), axis=1, initial=0.0)
        farthest[:1] = farthest[:1] if self._came else 0.0
        derived = np.where(same, np.nan, farthest / (1e-9 * steps(stamps, self._came)))
        speeds = np.append(self._speed, np.where(np.isnan(speeds), derived, speeds))
        latest = np.maximum.accumulate(np.where(np.isnan(speeds), 0, np.arange(len(speeds))))
        return np.asarray(speeds[latest][1:])

    def _check_effort(self, stamps: IntArray, numbers: FloatArray, moving: BoolArray) -> AnyArray:
        """Set invalid efforts to NaN. Return for each message ``(N,)`` the reason to refuse it, or None. Efforts that
        have been invalid for long do not refuse their message."""
        effort = numbers[:, 2]
        zeros = self._zeros(effort, moving)
        effort[zeros] = np.nan
        saturated = self._saturation.saturated(stamps, effort, numbers[:, 1], moving)
        effort[saturated | ~self._measuring(effort)] = np.nan
        measured, refusals = np.isfinite(effort), np.full(len(stamps), None)
        latest = np.concatenate([self._effort_stamps[None], np.where(measured, stamps[:, None], 0)])
        latest = np.maximum.accumulate(latest)
        self._effort_stamps = latest[-1]
        lost = ~measured & (latest[:-1] > 0) & (stamps[:, None] - latest[:-1] <= self.max_gap)
        for row in np.flatnonzero(lost.any(axis=1)):
            name = self.joints[int(np.argmax(lost[row]))]
            if saturated[row].any():
                refusals[row] = f"effort of '{name}' saturated: constant at its largest value"
            elif zeros[row]:
                refusals[row] = driver_error(f"effort of '{name}' and of all others is zero while the robot moves")
            elif not measured[row].any():
                refusals[row] = driver_error(f"no effort of '{name}' or any other joint")
            else:
                refusals[row] = f"effort of '{name}' missing or not finite"
        return refusals

    def _measuring(self, effort: FloatArray) -> BoolArray:
        """True for joints ``(N, J)`` whose effort has ever differed from zero. A joint without an effort sensor, such
        as a gripper, sends zeros that are no measurements."""
        shown = np.logical_or.accumulate(np.abs(effort) > 0.0, axis=0) | self._seen
        self._seen = shown[-1]
        return np.asarray(shown)

    def _zeros(self, effort: FloatArray, moving: BoolArray) -> BoolArray:
        """True ``(N,)`` if all efforts are zero and have been since the robot moved: the driver has no sensor."""
        all_zero: BoolArray = np.logical_not(effort.any(axis=1))
        places = np.arange(len(all_zero))
        last_nonzero = np.maximum.accumulate(np.where(all_zero, -1, places))
        last_moved = np.maximum.accumulate(np.where(all_zero & moving, places, -1))
        made_up: BoolArray = all_zero & ((last_moved > last_nonzero) | (self._made_up & (last_nonzero < 0)))
        self._made_up = bool(made_up[-1])
        return made_up


@dataclass(eq=False)
class LockedJoints:
    """Joints that count as fixed at zero, and what messages say of them nevertheless.

    Attributes:
        joints: their names.
        apart: distance between two positions that differ [rad, m].
        note: receives remarks.
    """

    joints: Collection[str]
    apart: float
    note: Callable[[str], None]
    _first: dict[str, float] = field(default_factory=dict)  # where they stand
    _moving: set[str] = field(default_factory=set)

    def watch(self, block: Block) -> None:
        """Note which of the joints do not stand at zero in joint messages, and which of them move."""
        for joint in sorted({*self.joints}.intersection(block.names) - self._moving):
            place = block.names.index(joint)
            positions = block.arrays[0][:, place : place + 1]
            positions = positions[plausible(positions)]
            if not len(positions):
                continue
            if joint not in self._first:
                self._first[joint] = first = float(positions[0])
                if self._are_apart(first, 0.0):
                    self.note(Reason(f"joint '{joint}' is locked at zero, but stands at {first:.3g}", "told"))
            if np.any(self._are_apart(positions, self._first[joint])):
                self._moving.add(joint)
                sentence = f"joint '{joint}' is locked at zero, but moves: take it out of locked_joints (--lock)"
                self.note(Reason(sentence, "driver error"))

    def _are_apart(self, positions: FloatArray | float, other: float) -> BoolArray:
        """True for positions that differ from another one by more than whole turns."""
        distance = np.abs(np.subtract(positions, other))
        return np.asarray(np.abs(distance - tau * np.rint(distance / tau)) > self.apart)


def _wrong_length(block: Block) -> str:
    """Say which array has another length than there are names; empty if none has."""
    names = len(block.names)
    for kind, values in zip(("position", "velocity", "effort"), block.arrays, strict=True):
        if values.shape[1] not in ((names,) if kind == "position" else (0, names)):
            return driver_error(f"{kind} has {values.shape[1]} entries for {names} names")
    return ""


@dataclass(eq=False)
class JointStateMerger:
    """Merges messages of several publishers, each with some of the joints, at the stamps of the fastest.

    The others' numbers are interpolated linearly between two messages. These must be no further apart than ``max_gap``
    or than their period explains. Efforts with a period longer than ``resolved`` are left out: positions are smooth
    between two messages, efforts need not be.

    Attributes:
        joints: joints of the robot.
        max_gap: [ns].
        resolved: [ns] longest period at which efforts can be filtered.
        make_reader: makes the reader of a part's messages.
        note: receives remarks on parts that are too slow.
        merges: True if there are several publishers; otherwise all messages have all joints.
    """

    joints: tuple[str, ...]
    max_gap: int
    resolved: int
    make_reader: Callable[[Part], JointReader]
    note: Callable[[str], None]
    merges: bool = True

    def __post_init__(self) -> None:
        self.readers: dict[Part, JointReader] = {} if self.merges else {self.joints: self.make_reader(self.joints)}
        self._periods: dict[Part, int] = {}  # [ns] of all parts, once known
        self.restart()

    def restart(self) -> None:
        """Restart after a clock was set or positions leapt."""
        for reader in self.readers.values():
            reader.restart()
        self._waiting: dict[Part, deque[tuple[int, FloatArray]]] = {part: deque() for part in self.readers}

    @property
    def silent(self) -> tuple[str, ...]:
        """Joints without messages for long, while those of others arrive."""
        newest = max((reader.stamp for reader in self.readers.values()), default=0)
        received = [
            joint
            for part, reader in self.readers.items()
            if newest - reader.stamp <= max(SILENT, self._longest_gap(part))
            for joint in part
        ]
        return tuple(joint for joint in self.joints if joint not in received) if newest else ()

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Joints whose efforts are left out, as they have been invalid for long or come too seldom."""
        failed = [joint for reader in self.readers.values() for joint in reader.unmeasured]
        slow = [joint for part in self._periods if self._is_slow(part) for joint in part]
        return tuple(dict.fromkeys([*failed, *slow]))

    def part(self, names: Sequence[str]) -> Part | str:
        """Return the part of a message with these names, or the reason why it is of several parts, or of none."""
        part = tuple(joint for joint in self.joints if joint in set(names)) if self.merges else self.joints
        if part in self.readers:
            return part
        if not part:
            return "none of the robot's joints" if names else driver_error("no joint names")
        shared = next((joint for other in self.readers for joint in other if joint in part), None)
        if shared is not None:
            return driver_error(f"joint '{shared}' comes with others than before")
        self.readers = {**self.readers, part: self.make_reader(part)}
        self._waiting[part] = deque()
        return part

    def add(self, part: Part, stamp: int, values: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Take a part's numbers ``(3 part_joints,)``. Yield stamps and numbers ``(3 joints,)`` of the whole robot."""
        waiting = self._waiting[part]
        waiting.append((stamp, values.reshape(3, -1)))
        if len(waiting) > MOST_WAITING:
            waiting.popleft()
        if not self._periods:
            self._measure_periods()
        if not self._periods:
            return
        fastest = self._waiting[min(self._periods, key=lambda other: self._periods[other])]
        while fastest and all(entries and entries[-1][0] >= fastest[0][0] for entries in self._waiting.values()):
            common = fastest[0][0]
            for entries in self._waiting.values():
                while len(entries) > 1 and entries[1][0] <= common:
                    entries.popleft()
            if all(self._is_known(other, common) for other in self._waiting):
                yield common, self._at(common)
            fastest.popleft()

    def _measure_periods(self) -> None:
        """Measure the periods of the parts, once all joints have been received for long enough."""
        if sum(map(len, self._waiting)) < len(self.joints):
            return
        firsts = {part: entries[0][0] for part, entries in self._waiting.items() if len(entries) > 1}
        newest = max(entries[-1][0] for entries in self._waiting.values() if entries)
        if len(firsts) < len(self._waiting) or newest - max(firsts.values()) < SILENT:
            return
        for part, entries in self._waiting.items():  # the first ones may have come in a burst
            spans = (newest - firsts[part]) // len(entries), (entries[-1][0] - firsts[part]) // (len(entries) - 1)
            self._periods[part] = max(spans)
        for part in self._periods:
            if self._is_slow(part):
                named = ", ".join(map(repr, part))
                rate = 1e9 / self._periods[part]
                self.note(f"only {rate:.1f} messages per second of {named}: the efforts there are left out")

    def _is_slow(self, part: Part) -> bool:
        """True if efforts come too seldom to be filtered."""
        return self._periods[part] > self.resolved

    def _longest_gap(self, part: Part) -> int:
        return max(self.max_gap, int(MISSED * self._periods.get(part, 0)))

    def _is_known(self, part: Part, stamp: int) -> bool:
        """True if a part has numbers at a stamp that its messages have reached."""
        entries = self._waiting[part]
        return entries[0][0] == stamp or (
            entries[0][0] < stamp and entries[1][0] - entries[0][0] <= self._longest_gap(part)
        )

    def _at(self, stamp: int) -> FloatArray:
        result = np.empty((3, len(self.joints)))
        for part, entries in self._waiting.items():
            numbers = _between(entries, stamp)
            if self._is_slow(part):
                numbers = np.concatenate([numbers[:2], np.full_like(numbers[2:], np.nan)])
            result[:, [self.joints.index(joint) for joint in part]] = numbers
        return result.ravel()


def _between(entries: deque[tuple[int, FloatArray]], stamp: int) -> FloatArray:
    first, before = entries[0]
    if first == stamp:
        return before
    second, after = entries[1]
    return before + (stamp - first) / (second - first) * (after - before)
