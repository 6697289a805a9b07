"""Physical effects beside the inertias: what is true of each joint, and how it enters MuJoCo or the measurement.

A mechanical effect is one function that changes the compiled model; an effect of measurement is one function that
changes the recorded effort. Either is registered by one line in its table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from geomid_ros.errors import unknown_name
from geomid_ros.simulation.description import JointLimits
from geomid_ros.simulation.options import JointEffect, SimulationOptions
from geomid_ros.types import FloatArray


def _viscous_friction(model: Any, dof: int, value: float) -> None:
    model.dof_damping[dof] = value


def _coulomb_friction(model: Any, dof: int, value: float) -> None:
    model.dof_frictionloss[dof] = value


def _rotor_inertia(model: Any, dof: int, value: float) -> None:
    model.dof_armature[dof] = value


def _effort_offset(effort: FloatArray, value: float) -> FloatArray:
    return effort + value


MECHANICAL: dict[str, Callable[[Any, int, float], None]] = {
    "viscous_friction": _viscous_friction,
    "coulomb_friction": _coulomb_friction,
    "rotor_inertia": _rotor_inertia,
}
MEASURED: dict[str, Callable[[FloatArray, float], FloatArray]] = {"effort_offset": _effort_offset}


def drawn_effects(
    options: SimulationOptions, joints: Sequence[JointLimits], rng: np.random.Generator
) -> tuple[JointEffect, ...]:
    """Every joint's effects: as ``options.effects`` says, otherwise drawn around the strengths in ``options``."""
    given = {(effect.name, effect.joint): effect for effect in options.effects}
    for effect in options.effects:
        _check(effect, joints)
    drawn = [JointEffect(name, joint.name, value) for joint in joints for name, value in _draw(options, joint, rng)]
    return tuple(given.get((effect.name, effect.joint), effect) for effect in drawn)


def measured_effort(effort: FloatArray, names: Sequence[str], effects: Iterable[JointEffect]) -> FloatArray:
    """What effort sensors without noise show for the true ``effort (T, n)`` of the joints ``names``."""
    measured = effort.copy()
    for effect in effects:
        if effect.name in MEASURED:
            joint = names.index(effect.joint)
            measured[:, joint] = MEASURED[effect.name](measured[:, joint], effect.value)
    return measured


def _check(effect: JointEffect, joints: Sequence[JointLimits]) -> None:
    if effect.name not in {**MECHANICAL, **MEASURED}:
        raise unknown_name("effect", effect.name, {**MECHANICAL, **MEASURED})
    names = [joint.name for joint in joints]
    if effect.joint not in names:
        raise unknown_name("joint", effect.joint, names)


def _draw(options: SimulationOptions, joint: JointLimits, rng: np.random.Generator) -> Iterable[tuple[str, float]]:
    viscous, dry, rotor, offset = rng.uniform(0.5, 1.5, 4).tolist()
    sign = -1.0 if rng.uniform() < 0.5 else 1.0
    yield "viscous_friction", viscous * options.viscous_friction * joint.effort / joint.velocity
    yield "coulomb_friction", dry * options.coulomb_friction * joint.effort
    yield "rotor_inertia", rotor * options.rotor_inertia * joint.effort / joint.velocity
    yield "effort_offset", sign * offset * options.effort_offset * joint.effort
