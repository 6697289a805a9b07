"""Effects that are constants of the compiled MuJoCo model."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomid_ros.simulation.effects.effect import Parameters, by_name
from geomid_ros.simulation.effects.forces import Places
from geomid_ros.types import FloatArray


def _viscous_friction(model: Any, at: Places, parameters: Parameters) -> None:
    model.dof_damping[at.joint] = parameters["coefficient"]


def _rotor_inertia(model: Any, at: Places, parameters: Parameters) -> None:
    model.dof_armature[at.joint] += parameters["inertia"]


def _spring(model: Any, at: Places, parameters: Parameters) -> None:
    model.jnt_stiffness[at.joint] = parameters["stiffness"]
    model.qpos_spring[at.joint] = parameters["equilibrium"]


def _joint_elasticity(model: Any, at: Places, parameters: Parameters) -> None:
    model.jnt_stiffness[at.play] = parameters["stiffness"]
    model.dof_damping[at.play] = parameters["damping"]


def _gravity_tilt(model: Any, _: Places, parameters: Parameters) -> None:
    model.opt.gravity[:] = rotation(parameters["tilt_x"], parameters["tilt_y"]).T @ model.opt.gravity


def rotation(x: float, y: float) -> FloatArray:
    """Rotation matrix ``(3, 3)`` of the rotation vector (x, y, 0) [rad]."""
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    angle = np.hypot(x, y)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross
    )


MODEL = by_name(_viscous_friction, _rotor_inertia, _spring, _joint_elasticity, _gravity_tilt)
