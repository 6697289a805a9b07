"""Streams of stamped numbers, interpolated on a common time grid and filtered there.

The grid's instants are the multiples of its period since the epoch. They do not depend on when the first message came:
a node that joins late and a reader of the whole bag make the same samples of the same messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.columns import Columns
from geomid_ros.model.effects import Motion
from geomid_ros.signals.kernels import cubic_weights, cubic_weights_at, derivative_kernels
from geomid_ros.types import FloatArray

_SHARPER = 4.0  # cutoff of the motion that effects are computed on, in units of the filter's
_SHARPEST = 0.4  # the highest such cutoff, as a share of the grid's rate


class Grid:
    """The common time grid: its ``period`` [ns], the kernels on it with ``half`` of their taps, the ``lag`` of samples
    in instants, and the ``stride`` from one sample to the next."""

    def __init__(self, period: int, cutoff: float, samples_per_cutoff_period: float) -> None:
        self.period = period
        self.kernels = derivative_kernels(cutoff, period * 1e-9)
        self.half = self.kernels.shape[1] // 2
        self.sharp_kernels = derivative_kernels(min(_SHARPER * cutoff, _SHARPEST / (period * 1e-9)), period * 1e-9)
        self.lag = self.half + self.sharp_kernels.shape[1] // 2
        self.stride = max(1, int(1e9 / (samples_per_cutoff_period * cutoff * period)))


class Segment(ABC):
    """Numbers of one topic without a pause. :meth:`push` takes them, :meth:`filtered` gives filtered values."""

    @abstractmethod
    def push(self, stamp: int, values: FloatArray) -> None:
        """Take the values of a message stamped ``stamp`` [ns], later than the one before."""

    @abstractmethod
    def ready(self) -> range:
        """Grid instants that can be filtered now."""

    @abstractmethod
    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Filtered values and their first two derivatives at ``instants`` (all ready), each ``(N, values)``."""

    @abstractmethod
    def drop_before(self, instant: int) -> None:
        """Forget what is needed only for earlier instants."""


S = TypeVar("S", bound=Segment)


class Stream(Generic[S]):
    """One topic's numbers. A pause longer than ``max_gap`` [ns] starts a new segment: nothing is interpolated or
    filtered across it. The segment before stays until the other topics, which may be later, have passed its end."""

    def __init__(self, max_gap: int, new_segment: Callable[[], S]) -> None:
        self._max_gap = max_gap
        self._new_segment = new_segment
        self._last: int | None = None
        self._segments = deque([new_segment()])

    @property
    def segment(self) -> S:
        """The oldest that is still needed."""
        return self._segments[0]

    def push(self, stamp: int, values: FloatArray) -> None:
        """Take the values of a message stamped ``stamp`` [ns], later than the one before."""
        if self._last is not None and stamp - self._last > self._max_gap:
            self._segments.append(self._new_segment())
        self._last = stamp
        self._segments[-1].push(stamp, values)

    def drop_before(self, instant: int) -> None:
        """Forget what is needed only for earlier instants."""
        self.skip_to(instant)
        self.segment.drop_before(instant)

    def skip_to(self, instant: int) -> bool:
        """Drop the segments that end before this instant. Returns whether there was one."""
        count = len(self._segments)
        while len(self._segments) > 1 and self.segment.ready().stop <= instant:
            self._segments.popleft()
        return len(self._segments) < count


class _GridValues:
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
        windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1, axis=0)[:: instants.step]
        # Without BLAS: its rounding depends on how many instants are asked for at once.
        return np.asarray(np.einsum("kl,ncl->knc", kernels, windows))

    def inside(self, half: int) -> range:
        """Instants with ``half`` neighbours on both sides."""
        return range(self.first + half, self.end - half)

    def drop_before(self, instant: int) -> None:
        """Forget older instants."""
        surplus = instant - self.first
        if surplus > 0:
            self.values = self.values[surplus:]
            self.first += surplus


class VectorSegment(Segment):
    """Plain vectors, interpolated by local cubics and filtered component by component."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._nodes: list[tuple[int, FloatArray]] = []
        self._on_grid = _GridValues()

    def push(self, stamp: int, values: FloatArray) -> None:
        self._nodes.append((stamp, values))
        if len(self._nodes) < 4:
            return
        self._nodes = self._nodes[-4:]
        start, end = self._nodes[1][0], self._nodes[2][0]
        next_instant = self._on_grid.end if len(self._on_grid.values) else -(-start // self._grid.period)
        instants = range(next_instant, end // self._grid.period + 1)
        if not instants:
            return
        origin = self._nodes[0][0]
        nodes = [float(stamp - origin) for stamp, _ in self._nodes]
        weights = np.array([cubic_weights_at(nodes, float(k * self._grid.period - origin)) for k in instants])
        stacked = np.array([values for _, values in self._nodes])
        self._on_grid.extend(instants.start, np.einsum("ni,ij->nj", weights, stacked))

    def ready(self) -> range:
        return self._on_grid.inside(self._grid.half)

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        value, first, second = self._on_grid.correlated(instants, self._grid.kernels)
        return value, first, second

    def drop_before(self, instant: int) -> None:
        self._on_grid.drop_before(instant - self._grid.half)


class JointSegment(VectorSegment):
    """Joint messages' vectors (positions first), and with them the columns of effects.

    Friction jumps when a joint reverses, and the filtered effort shows a smoothed jump. So effects are computed on a
    less filtered motion at every instant of the grid, and then filtered as the efforts are.
    """

    def __init__(self, grid: Grid, joints: int, columns: Columns) -> None:
        super().__init__(grid)
        self._joints = joints
        self._columns = columns
        self._sharp_half = grid.sharp_kernels.shape[1] // 2
        self._columns_on_grid = _GridValues()

    def push(self, stamp: int, values: FloatArray) -> None:
        super().push(stamp, values)
        possible = self._on_grid.inside(self._sharp_half)
        start = self._columns_on_grid.end if len(self._columns_on_grid.values) else possible.start
        half, stride = self._grid.half, self._grid.stride
        last_sample = (possible.stop - 1 - half) // stride * stride  # columns for later samples can wait
        instants = range(start, last_sample + half + 1)
        if instants:
            motion = self._on_grid.correlated(instants, self._grid.sharp_kernels, self._joints)
            self._columns_on_grid.extend(start, self._columns.values(Motion(*motion)).reshape(len(instants), -1))

    def ready(self) -> range:
        motion, columns = super().ready(), self._columns_on_grid.inside(self._grid.half)
        return range(max(motion.start, columns.start), min(motion.stop, columns.stop))

    def effects(self, instants: range) -> FloatArray:
        """Filtered columns ``(N, joints, effects)`` at ``instants`` (all ready)."""
        columns = self._columns_on_grid.correlated(instants, self._grid.kernels[:1])
        return columns.reshape(len(instants), self._joints, -1)

    def drop_before(self, instant: int) -> None:
        self._columns_on_grid.drop_before(instant - self._grid.half)
        self._on_grid.drop_before(min(instant - self._grid.half, self._columns_on_grid.end - self._sharp_half))


class PoseSegment(Segment):
    """Poses ``(7,)``, filtered and differentiated on SE(3).

    Around an instant, poses become logarithms relative to a reference pose, which is moved until the filtered
    logarithm vanishes: the filtered pose is the kernel-weighted mean on the group. There the derivatives of the
    logarithm are the body's spatial velocity and acceleration (linear, angular; base frame), as all structure terms of
    the group are multiples of the logarithm or of the velocity's bracket with itself.
    """

    _MEAN_STEPS = 4
    _MEAN_TOLERANCE = 1e-12

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._stamps: list[int] = []
        self._poses: list[FloatArray] = []

    def push(self, stamp: int, values: FloatArray) -> None:
        self._stamps.append(stamp)
        self._poses.append(values)

    def ready(self) -> range:
        if len(self._stamps) < 4:
            return range(0)
        half, period = self._grid.half, self._grid.period
        return range(-(-self._stamps[1] // period) + half, self._stamps[-2] // period + 1 - half)

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        parts = zip(*map(self._filtered_at, instants), strict=True)
        poses, velocities, accelerations = (np.array(part) for part in parts)
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
