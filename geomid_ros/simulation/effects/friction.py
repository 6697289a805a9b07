"""Dry friction: how large it is at a state. Within about 0.03 rad/s of standstill it is whatever stops the joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

Parameters = Mapping[str, float]
Level = Callable[[Parameters, float, float, float], float]
"""Magnitude [N m] from the parameters, the joint's position, its velocity and its motor's effort."""


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


FRICTION: dict[str, Level] = {
    "coulomb_friction": _coulomb_friction,
    "stribeck_friction": _stribeck_friction,
    "load_friction": _load_friction,
    "position_friction": _position_friction,
}
