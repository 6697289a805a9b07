"""Efforts that depend on the state: what the motors have to supply on top."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from geomid_ros.types import FloatArray

Parameters = Mapping[str, float]


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


FORCES: dict[str, Force] = {
    "cogging": _cogging,
    "cable_force": _cable_force,
    "joint_coupling": _joint_coupling,
    "backlash": _backlash,
}
