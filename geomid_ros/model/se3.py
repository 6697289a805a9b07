"""Logarithm, exponential and composition of poses, ``(7,)`` as position and quaternion xyzw."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from geomid_ros.types import FloatArray

_SMALL_ANGLE = 0.1


def relative_log(reference: FloatArray, poses: FloatArray) -> FloatArray:
    """``log(reference^-1 pose)`` of each of ``poses (N, 7)``, ``(N, 6)`` as (linear, angular)."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 of floating bases alone

    back = Rotation.from_quat(reference[3:]).inv()
    angular = (back * Rotation.from_quat(poses[:, 3:])).as_rotvec()
    displacement = back.apply(poses[:, :3] - reference[:3])
    across = np.cross(angular, displacement)
    coefficient = _second_coefficient(np.linalg.norm(angular, axis=1))
    linear = displacement - 0.5 * across + coefficient[:, None] * np.cross(angular, across)
    return np.hstack([linear, angular])


def _second_coefficient(angle: FloatArray) -> FloatArray:
    """``(1 - (angle/2) cot(angle/2)) / angle^2``, the coefficient of the squared bracket in the logarithm, ``(N,)``."""
    square = angle**2
    series = 1.0 / 12.0 + square / 720.0 + square**2 / 30240.0 + square**3 / 1209600.0
    safe = np.maximum(angle, _SMALL_ANGLE)
    closed = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    return np.where(angle < _SMALL_ANGLE, series, closed)


def compose_exp(reference: FloatArray, twist: FloatArray) -> FloatArray:
    """The pose ``reference exp(twist)`` ``(7,)``, for a twist ``(6,)``."""
    return np.array(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(reference) * pin.exp6(twist)))


def quaternion(axes: FloatArray) -> FloatArray:
    """The quaternion xyzw ``(4,)`` of a rotation, of which ``axes (3, 3)`` has the axes as columns."""
    return np.array(pin.Quaternion(axes).coeffs())
