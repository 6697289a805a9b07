"""An inertial measurement unit in place of the base's odometry.

An accelerometer measures the specific force, acceleration less gravity, and the equations of motion ask for no more:
which way is up changes nothing in them. It only says where a round foot touches the ground.
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

    def weighed(self, specific_force: FloatArray) -> FloatArray:
        """Lengths of ``specific_force (N, 3)`` as multiples of gravity ``(N,)``: about one, on average over time."""
        return np.asarray(np.linalg.norm(specific_force, axis=1) / np.linalg.norm(self.gravity))

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
        quaternions = se3.shortest_rotation(up @ self.rotation.T, against)
        falling = se3.turned_back(quaternions, self.gravity)
        acceleration = specific_force @ self.rotation.T - lever + falling
        still = np.zeros_like(turning)
        return (
            np.concatenate([still, quaternions], axis=1),
            np.concatenate([still, turning], axis=1),
            np.concatenate([acceleration, tilting], axis=1),
        )
