"""Merges joint messages of several publishers, each with some of the joints."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.clocks import MISSED
from geomid_ros.signals.joint_messages import JointReader
from geomid_ros.signals.ledger import driver_error
from geomid_ros.signals.settings import MOST_WAITING
from geomid_ros.types import FloatArray

SILENT = 1_000_000_000
"""[ns] delay relative to the other parts, above which a part is silent."""

Part: TypeAlias = tuple[str, ...]
"""Joints of one publisher, in the robot's order."""


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
