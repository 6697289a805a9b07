"""Streams of stamped numbers, interpolated on a common time grid and filtered there.

Grid points are the multiples of the period since the epoch. They do not depend on when the first message came: a node
that joins late and a reader of the whole bag make the same samples of the same messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.effects import JointEffect, Motion
from geomid_ros.model.samples import Entries
from geomid_ros.signals.clocks import steps
from geomid_ros.signals.kernels import GridValues, cubic_weights, derivative_kernels, highest_cutoff, noise_kernel
from geomid_ros.signals.settings import LONGEST_TOPIC_LAG, MEAN_STEPS, SAMPLES_PER_CUTOFF_PERIOD
from geomid_ros.types import FloatArray, IntArray

_SHARPER = 4.0  # cutoff of the motion for effects, in units of the filter's


class Grid:
    """Common time grid: its ``period`` [ns], the kernels on it with ``half`` of their taps, the ``lag`` of samples and
    the ``stride`` from one sample to the next, both in grid points."""

    def __init__(self, period: int, cutoff: float) -> None:
        self.period = period
        self.kernels = derivative_kernels(cutoff, period * 1e-9)
        self.noise_kernel = noise_kernel(self.kernels[2])
        self.half = self.kernels.shape[1] // 2
        self.sharp_kernels = derivative_kernels(min(_SHARPER * cutoff, highest_cutoff(period * 1e-9)), period * 1e-9)
        self.lag = self.half + self.sharp_kernels.shape[1] // 2
        self.stride = max(1, int(1e9 / (SAMPLES_PER_CUTOFF_PERIOD * cutoff * period)))


S = TypeVar("S", bound="VectorSegment")


class Stream(Generic[S]):
    """Data of one topic. A pause longer than ``max_gap`` [ns] starts a new segment: nothing is interpolated or filtered
    across it. The previous segment remains until the other topics, which may be later, have passed its end."""

    def __init__(self, max_gap: int, new_segment: Callable[[], S]) -> None:
        self._max_gap = max_gap
        self._new_segment = new_segment
        self._last: int | None = None
        self._segments = deque([new_segment()])

    @property
    def segment(self) -> S:
        """Oldest segment that is still needed."""
        return self._segments[0]

    def push(self, stamps: IntArray, values: FloatArray) -> None:
        """Take the values ``(N, values)`` of messages with increasing ``stamps (N,)`` [ns], later than before."""
        late = steps(stamps, stamps[0] if self._last is None else self._last) > self._max_gap
        pauses = np.flatnonzero(late).tolist()
        for begin, end in pairwise(sorted({0, *pauses, len(stamps)})):
            if begin in pauses:
                self._segments.append(self._new_segment())
            self._segments[-1].push(stamps[begin:end], values[begin:end])
        self._last = int(stamps[-1])

    def drop_before(self, instant: int) -> None:
        """Discard data that only earlier grid points need."""
        self.skip_to(instant)
        self.segment.drop_before(instant)

    def forget(self, grid: Grid) -> None:
        """Discard data that are so old that other topics are not waited for."""
        if self._last is not None:
            instant = (self._last - LONGEST_TOPIC_LAG) // grid.period - grid.lag
            if len(self._segments) > 1 or self.segment.ready().start < instant:
                self.drop_before(instant)

    def skip_to(self, instant: int) -> bool:
        """Drop the segments that end before this grid point. Return True if there was one."""
        count = len(self._segments)
        while len(self._segments) > 1 and self.segment.ready().stop <= instant:
            self._segments.popleft()
        return len(self._segments) < count


class VectorSegment:
    """Data of one topic without a pause: vectors, interpolated by local cubics and filtered per component.

    They are interpolated when needed, as many at once as possible.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._nodes: list[tuple[IntArray, FloatArray]] = []  # messages around later grid points
        self._count = 0
        self._last_stamps = [0, 0]
        self._next: int | None = None  # grid point to be interpolated
        self._on_grid = GridValues()

    def push(self, stamps: IntArray, values: FloatArray) -> None:
        """Take the values ``(N, values)`` of messages with increasing ``stamps (N,)`` [ns], later than before."""
        if self._next is None and self._count + len(stamps) > 1:
            self._next = -(-int(stamps[1 - self._count]) // self._grid.period)
        self._count += len(stamps)
        self._last_stamps = [*self._last_stamps, *stamps[-2:].tolist()][-2:]
        self._nodes.append((stamps, values))

    @property
    def _reached(self) -> range:
        """Remembered grid points between the second message and the last but one."""
        if self._count < 4 or self._next is None:
            return range(0)
        first = self._on_grid.first if len(self._on_grid.values) else self._next
        return range(first, self._last_stamps[0] // self._grid.period + 1)

    def _interpolate(self) -> None:
        """Interpolate the values at all reached grid points."""
        instants = range(self._next or 0, self._reached.stop)
        if not instants:
            return
        stamps, values = self._joined()
        times = np.arange(instants.start, instants.stop) * self._grid.period
        self._on_grid.extend(instants.start, self._between(stamps, values, times))
        self._next = instants.stop
        oldest = int(np.searchsorted(stamps, (instants.stop - 1) * self._grid.period, side="right")) - 1
        self._forget(stamps, values, min(oldest, len(stamps) - 3))

    def _joined(self) -> tuple[IntArray, FloatArray]:
        """Stamps and values of the remembered messages."""
        stamps, values = (np.concatenate(parts) for parts in zip(*self._nodes, strict=True))
        return stamps, values

    def _forget(self, stamps: IntArray, values: FloatArray, count: int) -> None:
        """Keep these messages, except for the first ``count``."""
        remaining = slice(max(count, 0), None)
        self._nodes = [(stamps[remaining].copy(), values[remaining].copy())]

    def _between(self, stamps: IntArray, values: FloatArray, times: IntArray) -> FloatArray:
        """Interpolate ``values (N, ...)`` at ``stamps (N,)`` to ``times`` [ns]."""
        start = np.minimum(np.maximum(np.searchsorted(stamps, times) - 2, 0), len(stamps) - 4)
        nodes, origins = start[:, None] + np.arange(4), stamps[start]
        weights = cubic_weights((stamps[nodes] - origins[:, None]).astype(float), (times - origins).astype(float))
        return np.asarray(np.einsum("ni,nij->nj", weights, values[nodes]))

    def ready(self) -> range:
        """Return the grid points that can be filtered now."""
        reached, half = self._reached, self._grid.half
        return range(reached.start + half, reached.stop - half)

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return filtered values and their first two derivatives at ``instants`` (all ready), each ``(N, values)``."""
        self._interpolate()
        value, first, second = self._on_grid.correlated(instants, self._grid.kernels)
        return value, first, second

    def noise(self, instants: range, columns: int) -> FloatArray:
        """Return values ``(N, columns)`` at ``instants`` (all ready) with the variance that white noise of the leading
        values has in their second derivative."""
        (noise,) = self._on_grid.correlated(instants, self._grid.noise_kernel, columns)
        return np.asarray(noise)

    def drop_before(self, instant: int) -> None:
        """Discard data that only earlier grid points need."""
        self._interpolate()
        self._on_grid.drop_before(instant - self._grid.half)


class HeldSegment(VectorSegment):
    """Commands: vectors that hold until the next ones, filtered per component. The value at a grid point is the mean
    from half a period before to half a period after."""

    @property
    def _reached(self) -> range:
        reached, period = super()._reached, self._grid.period
        return range(reached.start, min(reached.stop, (self._last_stamps[-1] - period // 2) // period + 1))

    def _between(self, stamps: IntArray, values: FloatArray, times: IntArray) -> FloatArray:
        begin = times - self._grid.period // 2
        end = begin + self._grid.period
        first, last = (np.maximum(np.searchsorted(stamps, side, side="right") - 1, 0) for side in (begin, end))
        ends = np.append(stamps[1:], np.iinfo(np.int64).max)
        total = np.zeros((len(times), *values.shape[1:]))
        for further in range(int(np.max(last - first)) + 1):  # in order, independent of blocks
            node = np.minimum(first + further, len(stamps) - 1)
            until = np.minimum(ends[node], end)
            total += np.where(first + further <= last, until - begin, 0)[:, None] * values[node]
            begin = until
        return np.asarray(total / self._grid.period)


class JointSegment(VectorSegment):
    """Vectors of joint messages (positions first), with the columns of effects.

    Friction jumps when a joint reverses, and the filtered effort shows a smoothed jump. So effects are computed from a
    less filtered motion at every grid point, and then filtered like the efforts.
    """

    def __init__(self, grid: Grid, entries: Entries) -> None:
        super().__init__(grid)
        self._entries = entries
        self._sharp_half = grid.sharp_kernels.shape[1] // 2
        self._entries_on_grid = GridValues()
        self._past: dict[type[JointEffect], FloatArray] = {}
        self._position = np.zeros((0, entries.joints))  # at the last grid point with known states of effects

    def ready(self) -> range:
        motion, margin = super().ready(), self._sharp_half
        entries = self._entries_on_grid
        start = entries.first + self._grid.half if len(entries.values) else motion.start + margin
        return range(max(motion.start, start), motion.stop - margin)

    def effects(self, instants: range) -> FloatArray:
        """Return the filtered entries of columns ``(N, entries)`` at ``instants`` (all ready)."""
        self._interpolate()
        half, entries = self._grid.half, self._entries_on_grid
        start = entries.end if len(entries.values) else self._on_grid.first + self._sharp_half
        missing = range(start, instants[-1] + half + 1)
        if missing:
            motion = self._on_grid.correlated(missing, self._grid.sharp_kernels, self._entries.joints)
            entries.extend(start, self._entries.values(Motion(motion, self._remembered(motion[0]))))
        (filtered,) = entries.correlated(instants, self._grid.kernels[:1])
        return np.asarray(filtered)

    def _remembered(self, position: FloatArray) -> dict[JointEffect, FloatArray]:
        """States of effects with memory at the next grid points, where joints are at ``position (N, J)``."""
        moved = steps(position, self._position if len(self._position) else position[:1])
        self._position = position[-1:]
        result: dict[JointEffect, FloatArray] = {}
        for kind, effects in self._entries.remembering.items():
            states = kind.states(effects, moved, self._past.get(kind, np.zeros((len(effects), moved.shape[1]))))
            self._past[kind] = states[-1]
            result |= zip(effects, np.moveaxis(states, 1, 0), strict=True)
        return result

    def drop_before(self, instant: int) -> None:
        self._interpolate()
        entries, before = self._entries_on_grid, instant - self._grid.half
        entries.drop_before(before)
        end = entries.end if len(entries.values) else before
        self._on_grid.drop_before(min(before, end - self._sharp_half))


class PoseSegment(VectorSegment):
    """Poses ``(7,)``, filtered and differentiated on SE(3).

    Around a grid point, poses become logarithms relative to a reference pose, which is moved until the filtered
    logarithm vanishes: the filtered pose is the kernel-weighted mean on the group. There the derivatives of the
    logarithm are the body's spatial velocity and acceleration (linear, angular; base frame), as all structure terms of
    the group are multiples of the logarithm or of the velocity's bracket with itself.
    """

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        nodes = self._joined()
        parts = zip(*(self._filtered_at(instant, *nodes) for instant in instants), strict=True)
        poses, velocities, accelerations = (np.array(part) for part in parts)
        return poses, velocities, accelerations

    def _filtered_at(
        self, instant: int, stamps: IntArray, poses: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        half, period = self._grid.half, self._grid.period
        window = np.arange(instant - half, instant + half + 1) * period
        origin = int(window[0])
        begin = int(np.searchsorted(stamps, window[0], side="right")) - 2
        end = int(np.searchsorted(stamps, window[-1], side="left")) + 2
        stamps, poses = stamps[begin:end], poses[begin:end]
        start = np.clip(np.searchsorted(stamps, window, side="right") - 2, 0, len(stamps) - 4)
        nodes = start[:, None] + np.arange(4)
        weights = cubic_weights((stamps - origin)[nodes].astype(float), (window - origin).astype(float))
        reference = poses[int(np.argmin(np.abs(stamps - instant * period)))]
        for _ in range(MEAN_STEPS):
            logs = np.einsum("ni,nij->nj", weights, se3.relative_log(reference, poses)[nodes])
            value, velocity, acceleration = self._grid.kernels @ logs
            reference = se3.compose_exp(reference, value)
        return reference, velocity, acceleration

    def drop_before(self, instant: int) -> None:
        if self._nodes:
            stamps, poses = self._joined()
            oldest = (instant - self._grid.half) * self._grid.period
            self._forget(stamps, poses, int(np.searchsorted(stamps, oldest, side="right")) - 2)
