"""Physical effects, one class each: what the files of this folder define is known everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules

from geomid_ros.errors import unknown_name
from geomid_ros.model.effects.effect import Effect as Effect
from geomid_ros.model.effects.effect import Hinge as Hinge
from geomid_ros.model.effects.effect import IdentifiedEffect as IdentifiedEffect
from geomid_ros.model.effects.effect import JointEffect as JointEffect
from geomid_ros.model.effects.effect import LoadEffect as LoadEffect
from geomid_ros.model.effects.effect import MotionEffect as MotionEffect
from geomid_ros.model.effects.effect import PairEffect as PairEffect
from geomid_ros.model.effects.effect import RobotEffect as RobotEffect
from geomid_ros.model.effects.effect import SensorEffect as SensorEffect
from geomid_ros.model.effects.effect import SituationEffect as SituationEffect
from geomid_ros.model.effects.parameters import KnownEffect as KnownEffect
from geomid_ros.model.effects.parameters import ParameterForm as ParameterForm
from geomid_ros.model.effects.parameters import Quantity as Quantity
from geomid_ros.model.effects.parameters import Values as Values
from geomid_ros.model.effects.situation import AtJoint as AtJoint
from geomid_ros.model.effects.situation import AtJoints as AtJoints
from geomid_ros.model.effects.situation import AtSensor as AtSensor
from geomid_ros.model.effects.situation import JointMotion as JointMotion
from geomid_ros.model.effects.situation import Motion as Motion
from geomid_ros.model.effects.situation import OnLink as OnLink
from geomid_ros.model.effects.situation import OnRobot as OnRobot
from geomid_ros.model.effects.situation import Place as Place
from geomid_ros.model.effects.situation import PlaceKind as PlaceKind
from geomid_ros.model.effects.situation import Situation as Situation
from geomid_ros.model.effects.situation import joint_of as joint_of
from geomid_ros.model.effects.situation import joints_of as joints_of

DEFAULT_EFFECTS = (
    "viscous_friction",
    "coulomb_friction",
    "rotor_inertia",
    "effort_offset",
    "wrench_offset",
    "imu_offset",
    "command_delay",
)
"""Names of the effects that are identified at every joint and sensor unless the user says otherwise."""

DEFAULT_CANDIDATES = (
    "load_friction",
    "stribeck_friction",
    "saturating_friction",
    "presliding",
    "spring",
    "coupled_viscous_friction",
    "coupled_coulomb_friction",
    "coupled_rotor_inertia",
)
"""Names of the effects that are identified where the data ask for them, unless the user says otherwise."""

_FIRST = (
    *("viscous_friction", "rotor_inertia", "effort_offset", "spring"),
    *("coulomb_friction", "stribeck_friction", "load_friction", "effort_gain"),
    *("joint_elasticity", "backlash", "effort_delay", "gravity_tilt"),
    *("payload", "wrench_offset", "imu_offset", "command_delay"),
    *("saturating_friction", "quadratic_friction", "presliding", "coupled_viscous_friction"),
    *("coupled_coulomb_friction", "coupled_rotor_inertia"),
)
"""The order in which effects are tried: these, then those of other files."""

EFFECTS: dict[str, type[Effect]] = {}
"""All effects, by name, in the order in which they are tried."""


def register(effect: type[Effect]) -> type[Effect]:
    """Make an effect known everywhere; may be used as a decorator.

    Raises:
        TypeError: there is another of its name, or the effect contradicts itself.
    """
    if effect.adds_up and effect.variants()[0].scanned:
        raise TypeError(f"{effect} has a constant to choose: two at one place do not add up, adds_up must be False")
    other = EFFECTS.setdefault(effect.name, effect)
    if other is not effect:
        raise TypeError(f"{other} and {effect} have the same name, '{effect.name}'")
    return effect


def _defined() -> Iterator[type[Effect]]:
    """The effects that the files of this folder define."""
    for file in sorted(own.name for own in iter_modules(__path__)):
        module = import_module(f"geomid_ros.model.effects.{file}")
        for cls in vars(module).values():
            if isinstance(cls, type) and cls.__module__ == module.__name__ and issubclass(cls, Effect):
                yield from [cls] if hasattr(cls, "name") else []


for _effect in sorted(_defined(), key=lambda cls: _FIRST.index(cls.name) if cls.name in _FIRST else len(_FIRST)):
    register(_effect)


def effect_class(name: str) -> type[Effect]:
    """The effect of that name. Raises InputError with the valid names for an unknown one."""
    if name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS)
    return EFFECTS[name]


def values_of(known: KnownEffect) -> dict[str, float]:
    """An effect's parameters without their units; what may be left out is zero."""
    optional = {form.name: 0.0 for form in effect_class(known.effect).parameters if form.optional}
    return optional | {name: quantity.value for name, quantity in known.parameters.items()}


def identifiable() -> dict[str, IdentifiedEffect]:
    """The effects that can be identified along with the inertias, by name: linear in their coefficients."""
    return {name: cls() for name, cls in EFFECTS.items() if issubclass(cls, IdentifiedEffect)}


def identified_effect(name: str) -> IdentifiedEffect:
    """The effect of that name that can be identified. Raises InputError with the valid names for an unknown one."""
    found = EFFECTS.get(name)
    if found is None or not issubclass(found, IdentifiedEffect):
        raise unknown_name("effect", name, identifiable())
    return found()
