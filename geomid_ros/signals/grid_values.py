"""Vectors at consecutive instants of the time grid, and sums over windows of them."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray


class GridValues:
    """Vectors at consecutive grid instants, the oldest at ``first``."""

    def __init__(self) -> None:
        self.first = 0
        self.values = np.zeros((0, 0))  # a view of the used part of the room
        self._room = self.values
        self._used = 0

    @property
    def end(self) -> int:
        """The instant after the last."""
        return self.first + len(self.values)

    def extend(self, start: int, values: FloatArray) -> None:
        """Append ``values (N, ...)`` from instant ``start`` on, which is the end unless there are no values yet."""
        if not len(self.values):
            self.first, self.values = start, values[:0]
        count = len(self.values) + len(values)
        if self._used + len(values) > len(self._room):
            self._room = np.empty((2 * count, values.shape[1]))
            self._room[: len(self.values)] = self.values
            self._used = len(self.values)
        self._room[self._used : self._used + len(values)] = values
        self._used += len(values)
        self.values = self._room[self._used - count : self._used]

    def correlated(self, instants: range, kernels: FloatArray, columns: int | None = None) -> FloatArray:
        """Correlate with ``kernels (kernels, 2 half + 1)`` around each instant.

        Args:
            instants: N of them, each with ``half`` neighbours on both sides.
            kernels: ``(kernels, 2 half + 1)``.
            columns: how many of the values, all unless given.

        Returns:
            ``(kernels, N, values)``.
        """
        half = kernels.shape[1] // 2
        values = self.values[instants.start - half - self.first : instants[-1] + half + 1 - self.first, :columns]
        result = np.empty((len(kernels), len(instants), values.shape[1]))
        # One sum of a fixed length after the other: their rounding does not depend on how many are asked for at once.
        if instants.step == 1:
            for column, signal in enumerate(np.ascontiguousarray(values.T)):
                for kernel, filtered in zip(kernels, result, strict=True):
                    filtered[:, column] = np.correlate(signal, kernel, "valid")
        else:
            for index, start in enumerate(range(0, len(instants) * instants.step, instants.step)):
                result[:, index] = kernels @ values[start : start + kernels.shape[1]]
        return result

    def inside(self, half: int) -> range:
        """Instants with ``half`` neighbours on both sides."""
        return range(self.first + half, self.end - half)

    def drop_before(self, instant: int) -> None:
        """Forget older instants."""
        surplus = instant - self.first
        if surplus > 0:
            self.values = self.values[surplus:]
            self.first += surplus
