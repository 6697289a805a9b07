"""Inertial measurement unit (IMU) in place of the base's odometry.

An accelerometer measures the specific force, acceleration minus gravity. The equations of motion need no more: they do
not depend on which way is up. The direction of up only determines where a round foot touches the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model import se3
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class Imu:
    """A ``topic`` of sensor_msgs/Imu, measured in the axes and at the origin of the URDF link ``frame``."""

    topic: str
    frame: str

    @staticmethod
    def parse(text: str) -> Imu:
        """Parse ``TOPIC:FRAME``. Raises InputError for any other form."""
        topic, _, frame = text.partition(":")
        if not topic or not frame or ":" in frame:
            raise InputError(f"imu '{text}' is not of the form TOPIC:FRAME, e.g. /imu:imu_link")
        return Imu(topic, frame)


@dataclass(frozen=True, eq=False)
class ImuMount:
    """Pose of an IMU on the base, and the ``gravity (3,)`` of the world [m/s^2].

    ``rotation (3, 3)`` takes vectors from the IMU's axes to the base's; ``origin (3,)`` is its position there [m].
    """

    rotation: FloatArray
    origin: FloatArray
    gravity: FloatArray

    def weighed(self, specific_force: FloatArray) -> FloatArray:
        """Return lengths of ``specific_force (N, 3)`` as multiples of gravity ``(N,)``; about one on average."""
        return np.asarray(np.linalg.norm(specific_force, axis=1) / np.linalg.norm(self.gravity))

    def base_motion(
        self, angular_velocity: FloatArray, angular_acceleration: FloatArray, specific_force: FloatArray, up: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the base's motion in the form of :class:`~geomid_ros.model.samples.Samples`.

        ``up`` gives the tilt; heading and position are arbitrary, and the linear velocity is zero. The acceleration
        minus gravity gives the measured specific force at the IMU, whatever ``up`` is.

        Args:
            angular_velocity, angular_acceleration, specific_force: ``(N, 3)`` in the IMU's axes.
            up: ``(N, 3)`` unit vectors against gravity, in the IMU's axes.

        Returns:
            Poses ``(N, 7)``, velocities and accelerations ``(N, 6)``.
        """
        rate, rate_change = angular_velocity @ self.rotation.T, angular_acceleration @ self.rotation.T
        lever_acceleration = np.cross(rate_change, self.origin) + np.cross(rate, np.cross(rate, self.origin))
        world_up = -self.gravity / np.linalg.norm(self.gravity)
        quaternions = se3.shortest_rotation(up @ self.rotation.T, world_up)
        gravity = se3.rotate_inverse(quaternions, self.gravity)
        acceleration = specific_force @ self.rotation.T - lever_acceleration + gravity
        zeros = np.zeros_like(rate)
        return (
            np.concatenate([zeros, quaternions], axis=1),
            np.concatenate([zeros, rate], axis=1),
            np.concatenate([acceleration, rate_change], axis=1),
        )
