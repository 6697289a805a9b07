"""Messages of an IMU on a moving base: from specific forces and angular velocities to the base's motion."""

from __future__ import annotations

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.imu import ImuMount
from geomid_ros.model.robot import STANDARD_GRAVITY
from geomid_ros.signals.kernels import GridValues
from geomid_ros.signals.ledger import driver_error
from geomid_ros.signals.streams import Grid, VectorSegment
from geomid_ros.types import FloatArray

_LEVELLING = 1.0  # [s] to both sides, over which the specific force is averaged
_UNLIKE_GRAVITY = 0.3  # as a share of it

_EXPECTED = "publish what the accelerometer measures, gravity included, in m/s^2 (sensor_msgs/Imu)"
IN_G = driver_error(f"the acceleration is in g: {_EXPECTED}")
GRAVITY_REMOVED = driver_error(
    f"the acceleration is about zero on average, the driver has removed gravity: {_EXPECTED}"
)
NO_SPECIFIC_FORCE = driver_error(f"the acceleration is not gravity on average: {_EXPECTED}")


class ImuSegment(VectorSegment):
    """Angular velocity and specific force of an IMU on the base, which make the base's motion.

    Over a second or two a robot gains little speed: what the specific force is on average points up. The average is
    taken in axes that do not turn, which the angular velocity tells.
    """

    def __init__(self, grid: Grid, mount: ImuMount) -> None:
        super().__init__(grid)
        self._mount = mount
        self._wide = round(_LEVELLING / (grid.period * 1e-9))
        self._weights = np.hanning(2 * self._wide + 3)[None, 1:-1] / (self._wide + 1)
        self._levelled = GridValues()  # specific forces in axes that do not turn, and the rotations to them
        self._rotation, self._rate = np.eye(3), np.zeros((0, 3))  # at the last instant

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
        self._levelled.extend(start, np.concatenate([forces, rotations.reshape(-1, 9)], axis=1))

    def ready(self) -> range:
        motion, levelled = super().ready(), self._levelled
        start = levelled.first if len(levelled.values) else self._reached.start
        return range(max(motion.start, start + self._wide), min(motion.stop, self._reached.stop - self._wide))

    def filtered(self, instants: range) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Poses ``(N, 7)``, velocities and accelerations ``(N, 6)`` of the base, as a :class:`PoseSegment` has them."""
        value, first, _ = super().filtered(instants)
        mean = self._mean(instants)
        rotations = self._levelled.values[np.array(instants) - self._levelled.first, 3:].reshape(-1, 3, 3)
        up = np.einsum("nji,nj->ni", rotations, mean)
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), np.finfo(float).tiny)
        return self._mount.base_motion(value[:, :3], first[:, :3], value[:, 3:], up)

    def _mean(self, instants: range) -> FloatArray:
        """The specific force over a second before and after ``(N, 3)``, in axes that do not turn."""
        (mean,) = self._levelled.correlated(instants, self._weights, 3)
        return np.asarray(mean)

    def faults(self, instants: range) -> list[str]:
        """What is wrong with the specific force at each of ``instants``, if it is not gravity on average."""
        return [_fault(weighed) for weighed in self._mount.weighed(self._mean(instants)).tolist()]

    def drop_before(self, instant: int) -> None:
        super().drop_before(instant)
        self._levelled.drop_before(instant - self._wide)


def _fault(weighed: float) -> str:
    """What is wrong with an average specific force of so many times gravity, if anything is."""
    if abs(weighed - 1.0) < _UNLIKE_GRAVITY:
        return ""
    if abs(STANDARD_GRAVITY * weighed - 1.0) < _UNLIKE_GRAVITY:
        return IN_G
    return GRAVITY_REMOVED if weighed < _UNLIKE_GRAVITY else NO_SPECIFIC_FORCE
