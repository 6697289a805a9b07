"""A base that moves as it is told: what samples have of it. Tests of the node move their robots with it, too."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from geomid_ros.types import FloatArray

_STEP = 1e-4  # [s] of the difference that differentiates the rotation vector's Jacobian


def moving_base(motion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses ``(N, 7)``, velocities and accelerations ``(N, 6)`` in the base's axes, linear first, as samples have them.

    ``motion (3, N, 6)``: translation [m] and rotation vector [rad] with their two derivatives.
    """
    count = motion.shape[1]
    pose, velocity, acceleration = np.empty((count, 7)), np.empty((count, 6)), np.empty((count, 6))
    for k, (x, dx, ddx) in enumerate(zip(*motion, strict=True)):
        rotation = pin.exp3(x[3:])
        pose[k] = pin.SE3ToXYZQUAT(pin.SE3(rotation, x[:3]))
        turning = pin.Jexp3(x[3:]) @ dx[3:]
        ahead, behind = (pin.Jexp3(x[3:] + h * dx[3:]) @ (dx[3:] + h * ddx[3:]) for h in (_STEP, -_STEP))
        velocity[k] = [*(rotation.T @ dx[:3]), *turning]
        linear = rotation.T @ ddx[:3] - np.cross(turning, rotation.T @ dx[:3])
        acceleration[k] = [*linear, *((ahead - behind) / (2.0 * _STEP))]
    return pose, velocity, acceleration
