"""How large efforts usually are, and how they change: what a spike is told by."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray

_CHUNK = 128  # messages, of which the usual size and change are measured
_FEWEST_CHUNKS = 2
_TAIL = 6  # messages of a chunk, at either end, that do not count
_IN_RANGE, _IN_CHANGES, _IN_LIMIT = 1.5, 8.0, 0.02  # the height of a spike


class UsualEfforts:
    """Learns from chunks of messages; what it says changes with a whole chunk only."""

    def __init__(self, limits: FloatArray) -> None:
        """
        Args:
            limits: ``(joints,)`` of efforts, infinite where there is none.
        """
        joints = len(limits)
        self._least = np.where(np.isfinite(limits), _IN_LIMIT * limits, 0.0)
        self._chunk = np.empty((_CHUNK, joints))
        self._count = 0
        self._chunks = 0
        self._low, self._high = np.full(joints, np.inf), np.full(joints, -np.inf)
        self._change = np.zeros(joints)
        self.spike = np.full(joints, np.inf)
        """The least height of a spike ``(joints,)``; infinite until it is known what is usual."""

    @property
    def room(self) -> int:
        """Messages until the chunk is whole."""
        return _CHUNK - self._count

    def add(self, efforts: FloatArray) -> None:
        """Take the efforts ``(N, joints)`` of messages, at most as many as there is room for."""
        self._chunk[self._count : self._count + len(efforts)] = efforts
        self._count += len(efforts)
        if self._count == _CHUNK:
            self._learn(self._chunk)
            self._count = 0

    def _learn(self, efforts: FloatArray) -> None:
        measured = ~np.isnan(efforts).any(axis=0)
        ends = np.partition(efforts, (_TAIL, len(efforts) - 1 - _TAIL), axis=0)
        change = np.partition(np.abs(np.diff(efforts, axis=0)), len(efforts) - 2 - _TAIL, axis=0)[-1 - _TAIL]
        self._low[measured] = np.minimum(self._low, ends[_TAIL])[measured]
        self._high[measured] = np.maximum(self._high, ends[-1 - _TAIL])[measured]
        self._change[measured] = np.maximum(self._change, change)[measured]
        self._chunks += 1
        if self._chunks >= _FEWEST_CHUNKS:
            height = np.maximum(_IN_RANGE * (self._high - self._low), _IN_CHANGES * self._change)
            self.spike = np.where(np.isfinite(self._low), np.maximum(height, self._least), np.inf)
