"""Efforts that depend on the state: dry friction, and what the motors have to supply on top."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from geomid_ros.simulation.effects.effect import Parameters, by_name
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class Places:
    """Indices of an effect's ``joint``, of the ``other`` one and of the hinge behind its ``play``, or -1."""

    joint: int
    other: int
    play: int


Force = Callable[[Parameters, Places, list[float], list[float], FloatArray], None]
"""Adds to the needed efforts (last), from parameters, places, positions and velocities of all hinges."""


def _cogging(
    parameters: Parameters, at: Places, position: list[float], _velocity: list[float], needed: FloatArray
) -> None:
    wave = math.sin(parameters["cycles"] * position[at.joint] + parameters["phase"])
    needed[at.joint] += parameters["amplitude"] * wave


def _cable_force(
    parameters: Parameters, at: Places, position: list[float], _velocity: list[float], needed: FloatArray
) -> None:
    wound = position[at.joint] + parameters["ratio"] * position[at.other] - parameters["start"]
    tension = parameters["stiffness"] * max(wound, 0.0)
    needed[at.joint] += tension
    needed[at.other] += parameters["ratio"] * tension


def _joint_coupling(
    parameters: Parameters, at: Places, _position: list[float], velocity: list[float], needed: FloatArray
) -> None:
    needed[at.joint] += parameters["coefficient"] * velocity[at.other]


def _backlash(
    parameters: Parameters, at: Places, position: list[float], velocity: list[float], needed: FloatArray
) -> None:
    """The flanks press but never pull; between them the link is free."""
    turned = position[at.play]
    pressed = abs(turned) - 0.5 * parameters["gap"]
    if pressed > 0.0:
        side = math.copysign(1.0, turned)
        force = parameters["stiffness"] * pressed + parameters["damping"] * side * velocity[at.play]
        needed[at.play] += side * max(force, 0.0)


FORCES: dict[str, Force] = by_name(_cogging, _cable_force, _joint_coupling, _backlash)

Level = Callable[[Parameters, float, float, float], float]
"""Magnitude [N m] of dry friction from the parameters, the joint's position, its velocity and its motor's effort.

Within about 0.03 rad/s of standstill, friction is whatever stops the joint."""


def _coulomb_friction(parameters: Parameters, _position: float, _velocity: float, _effort: float) -> float:
    return parameters["level"]


def _stribeck_friction(parameters: Parameters, _position: float, velocity: float, _effort: float) -> float:
    excess = parameters["excess"] * math.exp(-((velocity / parameters["speed"]) ** 2))
    return parameters["level"] + excess


def _load_friction(parameters: Parameters, _position: float, velocity: float, effort: float) -> float:
    """``c |tau|`` of the effort tau that is passed on: the motor's is ``tau + c |tau| sign(v)``, solved for tau."""
    passed = abs(effort) / (1.0 + parameters["coefficient"] * math.copysign(1.0, effort * velocity))
    return parameters["coefficient"] * passed


def _position_friction(parameters: Parameters, position: float, _velocity: float, _effort: float) -> float:
    wave = math.sin(parameters["cycles"] * position + parameters["phase"])
    return parameters["level"] * (1.0 + parameters["modulation"] * wave)


FRICTION: dict[str, Level] = by_name(_coulomb_friction, _stribeck_friction, _load_friction, _position_friction)
