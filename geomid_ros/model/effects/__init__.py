"""Physical effects, one file each: what is in a file of this folder is known everywhere."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from geomid_ros.errors import unknown_name
from geomid_ros.model.effects.effect import Effect, JointMotion, PhysicalEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect

__all__ = [
    "DEFAULT_EFFECTS",
    "EFFECTS",
    "PARAMETERS",
    "PHYSICAL_EFFECTS",
    "Effect",
    "JointMotion",
    "ParameterForm",
    "PhysicalEffect",
    "Situation",
    "SituationEffect",
    "effect",
]

DEFAULT_EFFECTS = ("viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset")
"""Names of the effects that are identified at every joint unless the user says otherwise."""


def _collected() -> dict[str, type[PhysicalEffect]]:
    """The classes with a name in the files of this folder, by name, in the order of the files."""
    found: dict[str, type[PhysicalEffect]] = {}
    for file in sorted(module.name for module in iter_modules(__path__)):
        for value in vars(import_module(f"{__name__}.{file}")).values():
            if isinstance(value, type) and issubclass(value, PhysicalEffect) and hasattr(value, "name"):
                other = found.setdefault(value.name, value)
                if other is not value:
                    raise TypeError(f"{other} and {value} have the same name, '{value.name}'")
    return found


PHYSICAL_EFFECTS = _collected()
"""All effects, by name."""

PARAMETERS = {name: {form.name: form for form in cls.parameters} for name, cls in PHYSICAL_EFFECTS.items()}
"""The parameters of all effects, by their names."""

EFFECTS: dict[str, Effect] = {
    name: cls() for name, cls in PHYSICAL_EFFECTS.items() if issubclass(cls, Effect) and len(cls.parameters) == 1
}
"""The effects that can be identified: functions of one joint's motion with one parameter, its coefficient."""


def effect(name: str) -> Effect:
    """The effect of that name that can be identified; an unknown one is answered with the valid names."""
    if name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS)
    return EFFECTS[name]
