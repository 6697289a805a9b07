"""An inertial measurement unit in place of the base's odometry.

An accelerometer measures the specific force, acceleration less gravity, and the equations of motion ask for no more:
which way is up changes nothing in them. It only says where a round foot touches the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class Imu:
    """A ``topic`` of sensor_msgs/Imu, measured in the axes and at the origin of the URDF link ``frame``."""

    topic: str
    frame: str

    @staticmethod
    def parse(text: str) -> Imu:
        """From ``TOPIC:FRAME``. Raises InputError for another form."""
        topic, _, frame = text.partition(":")
        if not topic or not frame or ":" in frame:
            raise InputError(f"imu '{text}' is not of the form TOPIC:FRAME, e.g. /imu:imu_link")
        return Imu(topic, frame)


@dataclass(frozen=True, eq=False)
class ImuMount:
    """Where an IMU is on the base, and the ``gravity (3,)`` of the world [m/s^2].

    ``rotation (3, 3)`` takes vectors from the IMU's axes to the base's, ``origin (3,)`` is its place there [m].
    """

    rotation: FloatArray
    origin: FloatArray
    gravity: FloatArray

    def base_motion(
        self, angular_velocity: FloatArray, angular_acceleration: FloatArray, specific_force: FloatArray, up: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The base's motion as :class:`~geomid_ros.model.samples.Samples` have it.

        The base stands upright as ``up`` says, with a heading and a place that do not matter, and does not move along;
        its acceleration is such that gravity adds up to the specific force that was measured, whatever ``up`` is.

        Args:
            angular_velocity, angular_acceleration, specific_force: ``(N, 3)`` in the IMU's axes.
            up: ``(N, 3)`` unit vectors against gravity, in the IMU's axes.

        Returns:
            Poses ``(N, 7)``, velocities and accelerations ``(N, 6)``.
        """
        turning, tilting = angular_velocity @ self.rotation.T, angular_acceleration @ self.rotation.T
        lever = np.cross(tilting, self.origin) + np.cross(turning, np.cross(turning, self.origin))
        against = -self.gravity / np.linalg.norm(self.gravity)
        quaternions = shortest_rotation(up @ self.rotation.T, against)
        falling = rotated(quaternions * [-1.0, -1.0, -1.0, 1.0], self.gravity)
        acceleration = specific_force @ self.rotation.T - lever + falling
        still = np.zeros_like(turning)
        return (
            np.concatenate([still, quaternions], axis=1),
            np.concatenate([still, turning], axis=1),
            np.concatenate([acceleration, tilting], axis=1),
        )


def shortest_rotation(vectors: FloatArray, onto: FloatArray) -> FloatArray:
    """Unit quaternions ``(N, 4)``, xyzw, of the smallest rotations that take unit ``vectors (N, 3)`` to the unit vector
    ``onto (3,)``; about any axis across where they are opposite."""
    axis, cosine = np.cross(vectors, onto), vectors @ onto
    opposite = cosine < -1.0 + 1e-9
    across = np.cross(onto, np.eye(3)[np.argmin(np.abs(onto))])
    axis[opposite], cosine[opposite] = across, -1.0
    quaternions = np.concatenate([axis, 1.0 + cosine[:, None]], axis=1)
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def rotated(quaternions: FloatArray, vector: FloatArray) -> FloatArray:
    """A ``vector (3,)`` turned by unit quaternions ``(N, 4)``, xyzw: ``(N, 3)``."""
    axis, real = quaternions[:, :3], quaternions[:, 3:]
    once = np.cross(axis, vector)
    return np.asarray(vector + 2.0 * (real * once + np.cross(axis, once)))
