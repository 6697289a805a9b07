"""Effects that add a body or a hinge to MuJoCo's description of the robot, before it is compiled."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from geomid_ros.simulation.description import INERTIA_NAMES, LinkInertia
from geomid_ros.simulation.effects.effect import TrueEffect
from geomid_ros.simulation.inertias import set_inertia

_COM = ("com_x", "com_y", "com_z")
GEARS = ("joint_elasticity", "backlash")
"""Effects that put another hinge behind a joint's motor."""


def play_name(joint: str) -> str:
    """Name of the hinge behind a joint's motor; its angle is that of the link less that of the motor."""
    return joint + "/play"


def wound(parameters: Mapping[str, float], effort: float) -> float:
    """How far [rad] a motor that holds ``effort`` [N m] is ahead of its link, through elasticity or backlash."""
    return effort / parameters["stiffness"] + math.copysign(0.5 * parameters.get("gap", 0.0), effort)


def _payload(mujoco: Any, spec: Any, effect: TrueEffect) -> None:
    body = spec.body(effect.link).add_body(name=effect.link + "/payload")
    set_inertia(mujoco, body, payload_inertia(effect))


def payload_inertia(effect: TrueEffect) -> LinkInertia:
    """A payload as a body in the frame of its link."""
    values = effect.parameters
    com, inertia = np.array([values[name] for name in _COM]), [[values[name] for name in row] for row in INERTIA_NAMES]
    return LinkInertia(effect.link, values["mass"], com, np.array(inertia))


def _gear(_: Any, spec: Any, effect: TrueEffect) -> None:
    """A light rotor in front of another hinge on the same axis."""
    motor = spec.joint(effect.joint)
    motor.armature = effect.parameters["rotor_inertia"]
    motor.parent.add_joint(name=play_name(effect.joint), type=motor.type, axis=motor.axis, pos=motor.pos)


STRUCTURE: dict[str, Callable[[Any, Any, TrueEffect], None]] = {
    "payload": _payload,
    "joint_elasticity": _gear,
    "backlash": _gear,
}
