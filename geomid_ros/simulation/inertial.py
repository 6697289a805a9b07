"""A body's inertia in MuJoCo's terms."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomid_ros.simulation.description import LinkInertia


def set_inertia(mujoco: Any, element: Any, body: LinkInertia) -> None:
    """Give a body of an MjSpec the inertia of ``body``, in the frame of that body."""
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    element.mass = body.mass
    element.ipos = body.com
    element.iquat = quaternion
    element.inertia = moments
    element.explicitinertial = True
