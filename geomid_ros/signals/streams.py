"""Streams of stamped numbers, brought to a common time grid and filtered there.

The grid's instants are the whole multiples of its period since the epoch, so they do not depend on when anybody began
to listen: a node that joins late and a reader of the whole bag make the same samples of the same messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from geomid_ros.model import se3
from geomid_ros.signals.kernels import cubic_weights, derivative_kernels
from geomid_ros.types import FloatArray


class Grid:
    """The common time grid: ``period`` [ns], the kernels on it, and every how many instants a sample is made."""

    def __init__(self, period: int, cutoff: float, samples_per_cutoff_period: float) -> None:
        self.period = period
        self.kernels = derivative_kernels(cutoff, period * 1e-9)
        self.half = self.kernels.shape[1] // 2
        self.stride = max(1, int(1e9 / (samples_per_cutoff_period * cutoff * period)))


class Stream(ABC):
    """One topic's numbers. Feed with :meth:`push`; ask for filtered instants with :meth:`filtered`.

    A pause longer than ``max_gap`` [ns] starts a new segment: nothing is interpolated or filtered across it.
    """

    def __init__(self, grid: Grid, max_gap: int) -> None:
        self._grid = grid
        self._max_gap = max_gap
        self._last: int | None = None

    def push(self, stamp: int, values: FloatArray) -> None:
        """Take the values of a message stamped ``stamp`` [ns], later than the one before."""
        if self._last is not None and stamp - self._last > self._max_gap:
            self._restart()
        self._last = stamp
        self._take(stamp, values)

    @abstractmethod
    def _restart(self) -> None:
        """Forget what was taken: a new segment begins."""

    @abstractmethod
    def _take(self, stamp: int, values: FloatArray) -> None:
        """Take values of the current segment."""

    @abstractmethod
    def ready(self) -> range:
        """Grid instants that can be filtered now."""

    @abstractmethod
    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Filtered values and their first two derivatives at ``instants`` (all ready), each ``(N, values)``."""

    @abstractmethod
    def drop_before(self, instant: int) -> None:
        """Instants before this one will not be asked for again."""


class VectorStream(Stream):
    """A stream of plain vectors, interpolated by local cubics and filtered component by component."""

    def __init__(self, grid: Grid, max_gap: int) -> None:
        super().__init__(grid, max_gap)
        self._restart()

    def _restart(self) -> None:
        self._nodes: list[tuple[int, FloatArray]] = []
        self._first = 0
        self._on_grid: list[FloatArray] = []

    def _take(self, stamp: int, values: FloatArray) -> None:
        self._nodes.append((stamp, values))
        if len(self._nodes) < 4:
            return
        self._nodes = self._nodes[-4:]
        start, end = self._nodes[1][0], self._nodes[2][0]
        next_instant = self._first + len(self._on_grid) if self._on_grid else -(-start // self._grid.period)
        instants = range(next_instant, end // self._grid.period + 1)
        if not instants:
            return
        if not self._on_grid:
            self._first = instants.start
        origin = self._nodes[0][0]
        nodes = np.array([[float(stamp - origin) for stamp, _ in self._nodes]])
        times = np.array([float(k * self._grid.period - origin) for k in instants])
        weights = cubic_weights(np.repeat(nodes, len(times), axis=0), times)
        stacked = np.array([values for _, values in self._nodes])
        self._on_grid += list(np.einsum("ni,ij->nj", weights, stacked))

    def ready(self) -> range:
        half = self._grid.half
        return range(self._first + half, self._first + len(self._on_grid) - half)

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        half = self._grid.half
        begin = instants.start - half - self._first
        last = instants[-1] + half + 1 - self._first
        values = np.array(self._on_grid[begin:last])
        windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1, axis=0)[:: instants.step]
        # Without BLAS: its rounding depends on how many instants are asked for at once.
        value, first, second = np.einsum("kl,ncl->knc", self._grid.kernels, windows)
        return value, first, second

    def drop_before(self, instant: int) -> None:
        surplus = instant - self._grid.half - self._first
        if surplus > 0:
            del self._on_grid[:surplus]
            self._first += surplus


class PoseStream(Stream):
    """A stream of poses ``(7,)``, filtered and differentiated on SE(3).

    Around an instant the poses are taken as logarithms relative to a reference, which is moved until the filtered
    logarithm vanishes: the filtered pose is the kernel-weighted mean on the group. There the logarithm's derivatives
    are the body's spatial velocity and acceleration (linear, angular; base frame), as the group's structure terms are
    multiples of the logarithm or of the velocity's bracket with itself.
    """

    _MEAN_STEPS = 4
    _MEAN_TOLERANCE = 1e-12

    def __init__(self, grid: Grid, max_gap: int) -> None:
        super().__init__(grid, max_gap)
        self._restart()

    def _restart(self) -> None:
        self._stamps: list[int] = []
        self._poses: list[FloatArray] = []

    def _take(self, stamp: int, values: FloatArray) -> None:
        self._stamps.append(stamp)
        self._poses.append(values)

    def ready(self) -> range:
        if len(self._stamps) < 4:
            return range(0)
        half, period = self._grid.half, self._grid.period
        return range(-(-self._stamps[1] // period) + half, self._stamps[-2] // period + 1 - half)

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        results = [self._filtered_at(instant) for instant in instants]
        poses, velocities, accelerations = (np.array(part) for part in zip(*results, strict=True))
        return poses, velocities, accelerations

    def _filtered_at(self, instant: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        half, period = self._grid.half, self._grid.period
        window = np.arange(instant - half, instant + half + 1) * period
        origin = int(window[0])
        begin = int(np.searchsorted(self._stamps, window[0], side="right")) - 2
        end = int(np.searchsorted(self._stamps, window[-1], side="left")) + 2
        stamps = np.array(self._stamps[begin:end])
        poses = np.array(self._poses[begin:end])
        left = np.clip(np.searchsorted(stamps, window, side="right") - 2, 0, len(stamps) - 4)
        nodes = left[:, None] + np.arange(4)
        weights = cubic_weights((stamps - origin)[nodes].astype(float), (window - origin).astype(float))
        reference = poses[int(np.argmin(np.abs(stamps - instant * period)))]
        for _ in range(self._MEAN_STEPS):
            logs = np.einsum("ni,nij->nj", weights, se3.relative_log(reference, poses)[nodes])
            value, velocity, acceleration = self._grid.kernels @ logs
            reference = se3.compose_exp(reference, value)
            if float(np.linalg.norm(value)) < self._MEAN_TOLERANCE:
                break
        return reference, velocity, acceleration

    def drop_before(self, instant: int) -> None:
        oldest = (instant - self._grid.half) * self._grid.period
        surplus = int(np.searchsorted(self._stamps, oldest, side="right")) - 2
        if surplus > 0:
            del self._stamps[:surplus]
            del self._poses[:surplus]
