"""How large the change of an effort is that is no motion: a spike."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray

_CHUNK = 128  # messages that are learned from at once
_TAIL = 6  # messages of a chunk, at either end, that do not count
_IN_RANGE, _IN_CHANGES, _IN_LIMIT = 1.5, 8.0, 0.02  # times the range of efforts, their changes, and the URDF's limit


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
