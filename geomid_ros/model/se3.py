"""Logarithm, exponential and composition of poses, ``(7,)`` as position and quaternion xyzw, by pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from geomid_ros.types import FloatArray


def relative_log(reference: FloatArray, poses: FloatArray) -> FloatArray:
    """``log(reference^-1 pose)`` of each of ``poses (N, 7)``, ``(N, 6)`` as (linear, angular)."""
    inverse = pin.XYZQUATToSE3(reference).inverse()
    return np.array([pin.log6(inverse * pin.XYZQUATToSE3(pose)).vector for pose in poses])


def compose_exp(reference: FloatArray, twist: FloatArray) -> FloatArray:
    """The pose ``reference exp(twist)`` ``(7,)``, for a twist ``(6,)``."""
    return np.array(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(reference) * pin.exp6(twist)))
