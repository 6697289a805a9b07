"""Joint messages of several publishers, each with some of the joints."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.joint_messages import DRIVER_ERROR, JointReader, RejectedError
from geomid_ros.types import FloatArray

_SILENT = 1_000_000_000  # [ns] behind the other parts
_MOST_WAITING = 10_000  # messages of a part, while another is silent

Part: TypeAlias = tuple[str, ...]
"""The robot's joints that come together, in the robot's order."""


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
