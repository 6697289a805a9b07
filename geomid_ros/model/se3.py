"""Logarithm, exponential and composition of poses, ``(7,)`` as position and quaternion xyzw."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from geomid_ros.types import FloatArray

_SMALL_ANGLE = 0.1


def relative_log(reference: FloatArray, poses: FloatArray) -> FloatArray:
    """``log(reference^-1 pose)`` of each of ``poses (N, 7)``, ``(N, 6)`` as (linear, angular)."""
    vector, scalar = _relative_quaternions(reference[3:], poses[:, 3:])
    sine = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(sine, scalar)
    stretch = np.divide(angle, sine, out=np.full(len(poses), 2.0), where=sine > 0.0)
    angular = stretch[:, None] * vector
    rotation = pin.XYZQUATToSE3(reference).rotation
    displacement = (poses[:, :3] - reference[:3]) @ rotation
    across = np.cross(angular, displacement)
    linear = displacement - 0.5 * across + _second_coefficient(angle)[:, None] * np.cross(angular, across)
    return np.hstack([linear, angular])


def _relative_quaternions(reference: FloatArray, quaternions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Vector ``(N, 3)`` and non-negative scalar part ``(N,)`` of ``reference^-1 quaternions (N, 4)``."""
    u, w = reference[:3], reference[3]
    vector = w * quaternions[:, :3] - quaternions[:, 3:] * u - np.cross(u, quaternions[:, :3])
    scalar = w * quaternions[:, 3] + quaternions[:, :3] @ u
    sign = np.where(scalar < 0.0, -1.0, 1.0)
    return sign[:, None] * vector, sign * scalar


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
