"""The parameters of the effects that a model can have: names, units, and the values that make sense."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

COM_ENTRIES = ("com_x", "com_y", "com_z")
INERTIA_ENTRIES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
"""In pinocchio's order."""


@dataclass(frozen=True)
class ParameterForm:
    """A parameter's units at a turning and a sliding joint, its range (ends excluded), whether it may be left out."""

    units: tuple[str, str]
    above: float = -math.inf
    below: float = math.inf
    optional: bool = False


def _alike(unit: str, names: Iterable[str], optional: bool = False) -> dict[str, ParameterForm]:
    return {name: ParameterForm((unit, unit), optional=optional) for name in names}


_EFFORT = ("N m", "N")

PARAMETERS: Mapping[str, Mapping[str, ParameterForm]] = {
    "viscous_friction": {"coefficient": ParameterForm(("N m s/rad", "N s/m"), above=0.0)},
    "coulomb_friction": {"level": ParameterForm(_EFFORT, above=0.0)},
    "stribeck_friction": {
        "level": ParameterForm(_EFFORT, above=0.0),
        "excess": ParameterForm(_EFFORT),
        "speed": ParameterForm(("rad/s", "m/s"), above=0.0),
    },
    "load_friction": {"coefficient": ParameterForm(("-", "-"), above=0.0, below=1.0)},
    "rotor_inertia": {"inertia": ParameterForm(("kg m^2", "kg"), above=0.0)},
    "spring": {"stiffness": ParameterForm(("N m/rad", "N/m")), "equilibrium": ParameterForm(("rad", "m"))},
    "effort_offset": {"offset": ParameterForm(_EFFORT)},
    "effort_gain": {"gain": ParameterForm(("-", "-"), above=0.0)},
    "effort_delay": {"delay": ParameterForm(("s", "s"), above=-1.0, below=1.0)},
    "gravity_tilt": {
        name: ParameterForm(("rad", "rad"), above=-math.pi, below=math.pi) for name in ("tilt_x", "tilt_y")
    },
    "payload": {
        "mass": ParameterForm(("kg", "kg"), above=0.0),
        **_alike("m", COM_ENTRIES),
        **_alike("kg m^2", INERTIA_ENTRIES, optional=True),
    },
    "joint_elasticity": {"stiffness": ParameterForm(("N m/rad", "N/m"), above=0.0)},
    "backlash": {
        "gap": ParameterForm(("rad", "m"), above=0.0),
        "drag": ParameterForm(("N m s/rad", "N s/m"), above=0.0, optional=True),
    },
    "wrench_offset": {**_alike("N", ("fx", "fy", "fz"), True), **_alike("N m", ("tx", "ty", "tz"), True)},
}
