"""Physical effects, in one table for each way to act: ``FORCES`` and ``FRICTION`` are efforts at every state, ``MODEL``
sets constants of MuJoCo's model, ``STRUCTURE`` adds bodies and hinges before it is compiled, ``MEASURED`` changes the
recorded samples.

A new effect is a small function, named after it, in one of these tables, and a public function in ``effect_sizes.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from geomid_ros.simulation.description import INERTIA_NAMES, LinkInertia, set_inertia
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.types import FloatArray

Parameters: TypeAlias = Mapping[str, float]
_Function = TypeVar("_Function", bound=Callable[..., Any])


def by_name(*functions: _Function) -> dict[str, _Function]:
    """Map the functions by the effects that they are named after."""
    return {function.__name__.removeprefix("_"): function for function in functions}


@dataclass(frozen=True)
class TrueEffect:
    """True effect ``name`` at ``joint``, with the values of its ``parameters``.

    ``joint`` is empty for the whole robot, and the topic for a wrench sensor. ``link`` is that of a payload; ``other``
    is the second joint of an effect that depends on two. ``effect_sizes.py`` describes the parameters and their units.
    """

    name: str
    joint: str
    parameters: Parameters
    link: str = ""
    other: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """Entry of the effect in a file: name, places and parameters."""
        places = {"joint": self.joint, "link": self.link, "other": self.other}
        present = {key: name for key, name in places.items() if name or key == "joint"}
        return {"effect": self.name, **present, "parameters": dict(self.parameters)}


@dataclass(frozen=True)
class Places:
    """Indices of an effect's ``joint``, of the ``other`` one and of the hinge of its ``play``, or -1."""

    joint: int
    other: int
    play: int


Force = Callable[[Parameters, Places, list[float], list[float], FloatArray], None]
"""Function that adds to the needed efforts (last), by parameters, places, positions q and velocities v of all
hinges."""


def _cogging(parameters: Parameters, at: Places, q: list[float], _v: list[float], needed: FloatArray) -> None:
    wave = math.sin(parameters["cycles"] * q[at.joint] + parameters["phase"])
    needed[at.joint] += parameters["amplitude"] * wave


def _cable_force(parameters: Parameters, at: Places, q: list[float], _v: list[float], needed: FloatArray) -> None:
    stretch = q[at.joint] + parameters["ratio"] * q[at.other] - parameters["start"]
    tension = parameters["stiffness"] * max(stretch, 0.0)
    needed[at.joint] += tension
    needed[at.other] += parameters["ratio"] * tension


def _joint_coupling(parameters: Parameters, at: Places, _q: list[float], v: list[float], needed: FloatArray) -> None:
    needed[at.joint] += parameters["coefficient"] * v[at.other]


def _backlash(parameters: Parameters, at: Places, q: list[float], v: list[float], needed: FloatArray) -> None:
    """Effort of flanks that press but never pull; between them the link is free."""
    angle = q[at.play]
    penetration = abs(angle) - 0.5 * parameters["gap"]
    if penetration > 0.0:
        side = math.copysign(1.0, angle)
        force = parameters["stiffness"] * penetration + parameters["damping"] * side * v[at.play]
        needed[at.play] += side * max(force, 0.0)


FORCES: dict[str, Force] = by_name(_cogging, _cable_force, _joint_coupling, _backlash)

Level = Callable[[Parameters, float, float, float], float]
"""Function for the magnitude [N m] of dry friction, by parameters, joint position, velocity and the motor effort that
other friction leaves.

Within about 0.03 rad/s of standstill, friction is whatever stops the joint."""


def _coulomb_friction(parameters: Parameters, _position: float, _velocity: float, _effort: float) -> float:
    return parameters["level"]


def _stribeck_friction(parameters: Parameters, _position: float, velocity: float, _effort: float) -> float:
    excess = parameters["excess"] * math.exp(-((velocity / parameters["speed"]) ** 2))
    return parameters["level"] + excess


def _load_friction(parameters: Parameters, _position: float, velocity: float, effort: float) -> float:
    """Friction ``c |tau|`` of the transmitted effort tau: the motor's is ``tau + c |tau| sign(v)``, solved for tau."""
    transmitted = abs(effort) / (1.0 + parameters["coefficient"] * math.copysign(1.0, effort * velocity))
    return parameters["coefficient"] * transmitted


def _position_friction(parameters: Parameters, position: float, _velocity: float, _effort: float) -> float:
    wave = math.sin(parameters["cycles"] * position + parameters["phase"])
    return parameters["level"] * (1.0 + parameters["modulation"] * wave)


FRICTION: dict[str, Level] = by_name(_coulomb_friction, _stribeck_friction, _load_friction, _position_friction)


def is_by_load(effect: TrueEffect) -> bool:
    """True for friction that depends on what the others of a joint leave of the effort: it is added last."""
    return effect.name == "load_friction"


def added_friction(
    effect: TrueEffect, position: float, velocity: float, effort: float, *, level: float, viscous: float
) -> float:
    """Dry friction [N m] that an effect adds at a joint to the ``level`` of others, under a motor's ``effort``, beside
    a coefficient of ``viscous`` friction."""
    left = effort - math.copysign(level, velocity) - viscous * velocity
    return FRICTION[effect.name](effect.parameters, position, velocity, left)


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


_COM = ("com_x", "com_y", "com_z")


def play_name(joint: str) -> str:
    """Name of the hinge behind a joint's motor; its angle is the link's minus the motor's."""
    return joint + "/play"


def wind_up(parameters: Mapping[str, float], effort: float) -> float:
    """Angle [rad] by which a motor that holds ``effort`` [N m] leads its link, through elasticity or backlash."""
    return effort / parameters["stiffness"] + math.copysign(0.5 * parameters.get("gap", 0.0), effort)


def _payload(mujoco: Any, spec: Any, effect: TrueEffect) -> None:
    body = spec.body(effect.link).add_body(name=effect.link + "/payload")
    set_inertia(mujoco, body, payload_inertia(effect))


def payload_inertia(effect: TrueEffect) -> LinkInertia:
    """Inertia of a payload in the frame of its link."""
    values = effect.parameters
    com, inertia = np.array([values[name] for name in _COM]), [[values[name] for name in row] for row in INERTIA_NAMES]
    return LinkInertia(effect.link, values["mass"], com, np.array(inertia))


def _gear(_: Any, spec: Any, effect: TrueEffect) -> None:
    """Add a light rotor in front of a second hinge on the same axis."""
    motor = spec.joint(effect.joint)
    motor.armature = effect.parameters["rotor_inertia"]
    motor.parent.add_joint(name=play_name(effect.joint), type=motor.type, axis=motor.axis, pos=motor.pos)


STRUCTURE: dict[str, Callable[[Any, Any, TrueEffect], None]] = {
    "payload": _payload,
    "joint_elasticity": _gear,
    "backlash": _gear,
}


def _effort_delay(trace: RunTrace, _: int, parameters: Parameters) -> RunTrace:
    measured_time = trace.time - parameters["delay"]
    columns = [np.interp(measured_time, trace.fine_time, column) for column in trace.fine_effort.T]
    return replace(trace, effort=np.stack(columns, axis=1))


def _effort_gain(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, parameters["gain"] * trace.effort[:, joint])


def _effort_offset(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, trace.effort[:, joint] + parameters["offset"])


def _drift(trace: RunTrace, joint: int, parameters: Parameters) -> RunTrace:
    return _with_effort(trace, joint, trace.effort[:, joint] + parameters["rate"] * trace.time)


def _wrench_offset(trace: RunTrace, _: int, parameters: Parameters) -> RunTrace:
    return replace(trace, wrench=trace.wrench + [parameters[name] for name in ("fx", "fy", "fz", "tx", "ty", "tz")])


def _with_effort(trace: RunTrace, joint: int, column: FloatArray) -> RunTrace:
    effort = trace.effort.copy()
    effort[:, joint] = column
    return replace(trace, effort=effort)


MEASURED = by_name(_effort_delay, _effort_offset, _effort_gain, _drift, _wrench_offset)
"""Sensor errors of efforts and wrench, applied in this order: a delayed signal is offset, then scaled."""


def noiseless_measurement(trace: RunTrace, joints: Sequence[str], effects: Iterable[TrueEffect]) -> RunTrace:
    """Readings of sensors without noise for a true ``trace`` of ``joints``."""
    order = list(MEASURED)
    for effect in sorted((e for e in effects if e.name in MEASURED), key=lambda effect: order.index(effect.name)):
        joint = joints.index(effect.joint) if effect.joint in joints else -1
        trace = MEASURED[effect.name](trace, joint, effect.parameters)
    return trace
