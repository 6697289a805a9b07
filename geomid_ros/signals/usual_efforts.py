"""How large efforts usually are, and how they change: what a spike is told by."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import BoolArray, FloatArray

CHUNK = 128
"""Messages that are learned from at once."""
CLEAR = 4.0
"""A jump is as many times the largest change between the messages before, or after."""
_TAIL = 6  # messages of a chunk, at either end, that do not count
_OF_ALL, _LARGE = 0.6, 0.1  # of the sum over joints that changes with the unit; that sum, at least, in ranges
_ABOVE = 2.0  # times what the change of all efforts together hardly exceeds
_NEAR = 2  # messages
_ONE_JOINT, _ALIKE = 0.97, 0.93  # largest share of one joint; squared cosine of the efforts before and after
_OTHER = 2.5  # least factor
_IN_RANGE, _IN_CHANGES, _IN_LIMIT = 1.5, 8.0, 0.02  # the height of a spike


class UsualEfforts:
    """Learns from chunks of messages; what it says changes with a whole chunk only."""

    def __init__(self, limits: FloatArray) -> None:
        """
        Args:
            limits: ``(joints,)`` of efforts, infinite where there is none.
        """
        self._least = np.where(np.isfinite(limits), _IN_LIMIT * limits, 0.0)
        self.forget()

    def forget(self) -> None:
        """Begin to learn anew."""
        joints = len(self._least)
        self._chunk = np.empty((CHUNK, joints))
        self._count = 0
        self._low, self._high = np.full(joints, np.inf), np.full(joints, -np.inf)
        self._change = np.zeros(joints)
        self._usual_total = np.inf  # above it the change of all efforts together is suspicious
        self._inverse_range = np.zeros(joints)  # zero where it is not known
        self.spike = np.full(joints, np.inf)
        """The least height of a spike ``(joints,)``; infinite until it is known what is usual."""

    @property
    def room(self) -> int:
        """Messages until the chunk is whole."""
        return CHUNK - self._count

    def add(self, efforts: FloatArray) -> bool:
        """Take the efforts ``(N, joints)`` of messages, at most as many as there is room for. Returns whether the chunk
        was whole, so that something was learned."""
        self._chunk[self._count : self._count + len(efforts)] = efforts
        self._count += len(efforts)
        if self._count < CHUNK:
            return False
        self._learn(self._chunk)
        self._count = 0
        return True

    def jump(self, before: FloatArray, after: FloatArray) -> BoolArray:
        """Between which messages an effort changes by a spike's height, or all do as by another unit ``(N,)``.

        Args:
            before: ``(N, joints)`` efforts of one message each.
            after: those of the next.
        """
        change = np.abs(after - before)
        found: BoolArray = np.any(change > self.spike, axis=1)
        known = self._inverse_range > 0.0
        sums = [np.abs(efforts[:, known]) @ self._inverse_range[known] for efforts in (after, before)]
        size = np.where(np.minimum(*sums) > 0.0, np.maximum(*sums), 0.0)  # zeros are no efforts in another unit
        total = change[:, known] @ self._inverse_range[known]
        least = np.maximum(_OF_ALL * size, self._usual_total)
        return found | ((total > least) & (size > _LARGE * np.sum(known)))

    def factor(self, before: FloatArray, after: FloatArray) -> float:
        """The factor by which all efforts change at once, as by another unit or sign; 0 if they do not.

        Args:
            before: ``(M, joints)`` of some messages.
            after: ``(N, joints)`` of the next.
        """
        old, new = (np.mean(end, axis=0) * self._inverse_range for end in (before[-_NEAR:], after[:_NEAR]))
        if not np.isfinite(old @ new) or not old.any() or np.max(old**2) > _ONE_JOINT * (old @ old):
            return 0.0
        steps = [np.diff(efforts, axis=0) * self._inverse_range for efforts in (before, after)]
        usual = max(float(np.max(np.sum(step**2, axis=1), initial=0.0)) for step in steps)
        if not np.sum((new - old) ** 2) > CLEAR**2 * usual:
            return 0.0
        alike = (old @ new) ** 2 > _ALIKE * (old @ old) * (new @ new)
        factor = (old @ new) / (old @ old)
        if not alike or 1.0 / _OTHER < factor < _OTHER:
            return 0.0
        return float(f"{factor:.1g}")

    def _learn(self, efforts: FloatArray) -> None:
        measured = ~np.isnan(efforts).any(axis=0)
        ends = np.partition(efforts, (_TAIL, len(efforts) - 1 - _TAIL), axis=0)
        change = np.partition(np.abs(np.diff(efforts, axis=0)), len(efforts) - 2 - _TAIL, axis=0)[-1 - _TAIL]
        self._low[measured] = np.minimum(self._low, ends[_TAIL])[measured]
        self._high[measured] = np.maximum(self._high, ends[-1 - _TAIL])[measured]
        self._change[measured] = np.maximum(self._change, change)[measured]
        height = np.maximum(_IN_RANGE * (self._high - self._low), _IN_CHANGES * self._change)
        known = np.isfinite(self._low) & (self._high > self._low)
        self._inverse_range = np.where(known, 1.0 / np.where(known, self._high - self._low, 1.0), 0.0)
        totals = np.abs(np.diff(efforts[:, known], axis=0)) @ self._inverse_range[known]
        self._usual_total = _ABOVE * float(np.partition(totals, -1 - _TAIL)[-1 - _TAIL])
        self.spike = np.where(np.isfinite(self._low), np.maximum(height, self._least), np.inf)
