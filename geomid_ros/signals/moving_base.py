"""Moving base: its motion from the messages of an IMU, and which of its feet stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.samples import Samples
from geomid_ros.signals.kernels import GridValues
from geomid_ros.signals.ledger import driver_error
from geomid_ros.signals.streams import Grid, VectorSegment
from geomid_ros.types import BoolArray, FloatArray, IntArray

_LEVELLING = 1.0  # [s] before and after, over which the specific force is averaged
_UNLIKE_GRAVITY = 0.3  # as a fraction of gravity
LIFTED = 0.1
"""Largest load of a foot in the air, as a fraction of its load when all feet stand: inertias are not known yet."""

# Gravity removed, and gravity in g, look alike: a robot that moves shows a tenth of it now and then.
NO_GRAVITY = driver_error(
    "the acceleration is not gravity on average: it is in g, or the driver has removed gravity: publish what the "
    "accelerometer measures, gravity included, in m/s^2 (sensor_msgs/Imu)"
)
TURNS_OTHERWISE = driver_error(
    "the angular velocity is not that with which gravity turns in the acceleration: publish both in the axes of the "
    "IMU, rad/s and m/s^2 (sensor_msgs/Imu)"
)


class ImuSegment(VectorSegment):
    """Motion of the base from the angular velocity and specific force of its IMU.

    Over a second or two a robot gains little speed, so the mean specific force points up. The mean is taken in axes
    that do not rotate, from the integrated angular velocity.
    """

    def __init__(self, grid: Grid, mount: ImuMount) -> None:
        super().__init__(grid)
        self._mount = mount
        self._wide = round(_LEVELLING / (grid.period * 1e-9))
        self._weights = np.hanning(2 * self._wide + 3)[None, 1:-1] / (self._wide + 1)
        self._levelled = GridValues()  # specific forces in non-rotating axes, their norms, and the rotations to them
        self._rotation, self._rate = np.eye(3), np.zeros((0, 3))  # at the last grid point

    def _interpolate(self) -> None:
        super()._interpolate()
        start = self._levelled.end if len(self._levelled.values) else self._on_grid.first
        new = self._on_grid.values[start - self._on_grid.first :]
        if not len(new):
            return
        rates = np.concatenate([self._rate if len(self._rate) else new[:1, :3], new[:, :3]])
        turns = se3.rotations(0.5 * (rates[1:] + rates[:-1]) * self._grid.period * 1e-9)
        rotations = np.empty((len(new), 3, 3))
        for rotation, turn in zip(rotations, turns, strict=True):
            rotation[:] = self._rotation = self._rotation @ turn
        self._rate = rates[-1:]
        forces = np.einsum("nij,nj->ni", rotations, new[:, 3:])
        norms = np.linalg.norm(forces, axis=1, keepdims=True)
        self._levelled.extend(start, np.concatenate([forces, norms, rotations.reshape(-1, 9)], axis=1))

    def ready(self) -> range:
        motion, levelled = super().ready(), self._levelled
        start = levelled.first if len(levelled.values) else self._reached.start
        return range(max(motion.start, start + self._wide), min(motion.stop, self._reached.stop - self._wide))

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return poses ``(N, 7)``, velocities and accelerations ``(N, 6)`` of the base, as in :class:`PoseSegment`."""
        value, first, _ = super().filtered(instants)
        rotations = self._levelled.values[np.array(instants) - self._levelled.first, 4:].reshape(-1, 3, 3)
        up = np.einsum("nji,nj->ni", rotations, self._mean(instants)[:, :3])
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), np.finfo(float).tiny)
        return self._mount.base_motion(value[:, :3], first[:, :3], value[:, 3:], up)

    def _mean(self, instants: range) -> FloatArray:
        """Mean specific force over a second before and after, in non-rotating axes, and its mean norm ``(N, 4)``."""
        (mean,) = self._levelled.correlated(instants, self._weights, 4)
        return np.asarray(mean)

    def faults(self, instants: range) -> list[str]:
        """Return the fault at each of ``instants``; empty where the mean specific force is gravity."""
        mean = self._mean(instants)
        ratios = np.column_stack([self._mount.weighed(mean[:, :3]), self._mount.weighed(mean[:, 3:])])
        return [_fault(*pair) for pair in ratios.tolist()]

    def drop_before(self, instant: int) -> None:
        super().drop_before(instant)
        self._levelled.drop_before(instant - self._wide)


def _fault(ratio: float, of_norm: float) -> str:
    """Fault of a mean specific force that is ``ratio`` times gravity, and its mean norm ``of_norm`` times; empty if
    there is none. If only the norm is that of gravity, it was not turned as the IMU turned."""
    if abs(ratio - 1.0) < _UNLIKE_GRAVITY:
        return ""
    return TURNS_OTHERWISE if abs(of_norm - 1.0) < _UNLIKE_GRAVITY else NO_GRAVITY


class Stance:
    """Determines at each sample which feet may touch the ground. A foot is in the air if its leg bears almost no load
    for ``1 / cutoff`` before and after; samples are held until that is known."""

    def __init__(self, loads: Callable[[Samples], FloatArray], cutoff: float) -> None:
        """
        Args:
            loads: function that computes the load of each foot ``(N, feet)``, as a fraction of weight / number of feet
                (:meth:`~geomid_ros.model.moving_base.Legs.loads`).
            cutoff: cutoff of the low-pass on all signals [Hz].
        """
        self._loads = loads
        self._span = round(1e9 / cutoff)  # [ns] by which the low-pass smears a change to both sides
        self._held: Samples | None = None
        self._before = 0  # number of held samples that were returned already
        self._borne = np.zeros((0, 0))  # loads of the feet at the held samples

    def with_stance(self, new: Samples) -> Samples | None:
        """Take samples in the order of time. Return those whose standing feet are known."""
        parts = [ready for part in in_order(new) if (ready := self._take(part)) is not None]
        return Samples.concatenate(parts) if parts else None

    def _take(self, new: Samples) -> Samples | None:
        loads = self._loads(new)
        if self._held is not None and new.stamps[0] > self._held.stamps[-1]:
            new = Samples.concatenate([self._held, new])
            loads = np.concatenate([self._borne, loads])
        else:
            self._before = 0
        stamps, begin = new.stamps, self._before
        end = int(np.searchsorted(stamps, stamps[-1] - self._span, side="right"))
        oldest = int(np.searchsorted(stamps, stamps[end] - self._span))
        kept = slice(min(oldest, end), None)
        self._held, self._borne, self._before = new.select(kept), loads[kept], max(end, begin) - kept.start
        if end <= begin:
            return None
        standing = within(stamps, ~(loads < LIFTED), self._span)[begin:end]
        return replace(new.select(slice(begin, end)), standing=standing)


def within(stamps: IntArray, true: BoolArray, span: int) -> BoolArray:
    """True if anything is ``true (N, feet)`` at most ``span`` before or after each of ``stamps (N,)``."""
    first, last = np.searchsorted(stamps, stamps - span), np.searchsorted(stamps, stamps + span, side="right")
    count = np.concatenate([np.zeros((1, true.shape[1]), dtype=np.int64), np.cumsum(true, axis=0)])
    return np.asarray(count[last] > count[first])


def in_order(samples: Samples) -> list[Samples]:
    """Split samples where the clock was set back."""
    ends = np.flatnonzero(np.diff(samples.stamps) <= 0) + 1
    bounds = [0, *ends.tolist(), len(samples)]
    return [samples.select(slice(*bounds[k : k + 2])) for k in range(len(bounds) - 1)]
