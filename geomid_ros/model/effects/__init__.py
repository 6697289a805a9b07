"""Physical effects, one class each. Effects defined in the files of this folder are registered automatically."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules

import numpy as np

from geomid_ros.errors import check_name, unknown_name
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects.effect import Effect as Effect
from geomid_ros.model.effects.effect import GravityEffect as GravityEffect
from geomid_ros.model.effects.effect import Hinge as Hinge
from geomid_ros.model.effects.effect import IdentifiedEffect as IdentifiedEffect
from geomid_ros.model.effects.effect import JointEffect as JointEffect
from geomid_ros.model.effects.effect import LoadEffect as LoadEffect
from geomid_ros.model.effects.effect import MotionEffect as MotionEffect
from geomid_ros.model.effects.effect import PairEffect as PairEffect
from geomid_ros.model.effects.effect import RobotEffect as RobotEffect
from geomid_ros.model.effects.effect import SensorEffect as SensorEffect
from geomid_ros.model.effects.effect import SituationEffect as SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm as ParameterForm
from geomid_ros.model.effects.parameters import Quantities
from geomid_ros.model.effects.parameters import Quantity as Quantity
from geomid_ros.model.effects.parameters import Values as Values
from geomid_ros.model.effects.sensor_errors import DriveGain as DriveGain
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
from geomid_ros.types import FloatArray

DEFAULT_EFFECTS = (
    "viscous_friction",
    "coulomb_friction",
    "rotor_inertia",
    "effort_offset",
    "wrench_offset",
    "imu_offset",
    "command_delay",
)
"""Names of the effects identified at every joint and sensor by default."""

DEFAULT_CANDIDATES = (
    "load_friction",
    "stribeck_friction",
    "saturating_friction",
    "presliding",
    "spring",
    "coupled_viscous_friction",
    "coupled_coulomb_friction",
    "coupled_rotor_inertia",
    "gravity_tilt",
)
"""Names of the effects identified by default where the data support them."""

_FIRST = (
    *("viscous_friction", "rotor_inertia", "effort_offset", "spring"),
    *("coulomb_friction", "stribeck_friction", "load_friction", "drive_gain", "effort_gain"),
    *("joint_elasticity", "backlash", "effort_delay", "gravity_tilt"),
    *("payload", "wrench_offset", "imu_offset", "command_delay"),
    *("saturating_friction", "quadratic_friction", "presliding", "coupled_viscous_friction"),
    *("coupled_coulomb_friction", "coupled_rotor_inertia"),
    "encoder_offset",
)
"""Order in which effects are tried: these first, then all others."""

EFFECTS: dict[str, type[Effect]] = {}
"""All effects by name, in the order in which they are tried."""


def register(effect: type[Effect]) -> type[Effect]:
    """Register an effect everywhere; usable as a decorator.

    Raises:
        TypeError: if another effect has its name, or its declaration is inconsistent.
    """
    if effect.adds_up and effect.grid()[0].grid_value:
        raise TypeError(f"{effect} has a constant to choose: two at one place do not add up, adds_up must be False")
    other = EFFECTS.setdefault(effect.name, effect)
    if other is not effect:
        raise TypeError(f"{other} and {effect} have the same name, '{effect.name}'")
    return effect


def _defined() -> Iterator[type[Effect]]:
    """Yield the effects that the files of this folder define."""
    for file in sorted(module_info.name for module_info in iter_modules(__path__)):
        module = import_module(f"geomid_ros.model.effects.{file}")
        for cls in vars(module).values():
            if isinstance(cls, type) and cls.__module__ == module.__name__ and issubclass(cls, Effect):
                yield from [cls] if hasattr(cls, "name") else []


for _effect in sorted(_defined(), key=lambda cls: _FIRST.index(cls.name) if cls.name in _FIRST else len(_FIRST)):
    register(_effect)


def effect_class(name: str) -> type[Effect]:
    """Return the effect of that name. Raises InputError with the valid names for an unknown one."""
    check_name("effect", name, EFFECTS)
    return EFFECTS[name]


def identifiable() -> dict[str, IdentifiedEffect]:
    """Return the effects that can be identified with the inertias, by name: linear in their coefficients."""
    return {name: cls() for name, cls in EFFECTS.items() if issubclass(cls, IdentifiedEffect)}


def identified_effect(name: str) -> IdentifiedEffect:
    """Return the identifiable effect of that name. Raises InputError with the valid names for an unknown one."""
    effect = EFFECTS.get(name)
    if effect is None or not issubclass(effect, IdentifiedEffect):
        raise unknown_name("effect", name, identifiable())
    return effect()


@dataclass(frozen=True)
class KnownEffect:
    """An effect with the values of its parameters, as estimated or read from a file.

    Attributes:
        effect: its name.
        joint: joint where it acts, two joints as ``FIRST+SECOND``, the joint that moves a payload's link, or the topic
            of a wrench sensor; empty for the whole robot.
        link: link that carries a payload; else empty.
        parameters: values with standard deviations and units, by name.
    """

    effect: str
    joint: str = ""
    link: str = ""
    parameters: Quantities = field(default_factory=dict)

    @property
    def cls(self) -> type[Effect]:
        """Class of the effect. Raises InputError if there is none of its name."""
        return effect_class(self.effect)

    @property
    def location(self) -> str:
        """Name of the place: that of the link, or of the joint or sensor."""
        return self.link or self.joint

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name; optional ones default to zero."""
        optional = {form.name: 0.0 for form in self.cls.parameters if form.optional}
        return optional | {name: quantity.value for name, quantity in self.parameters.items()}

    @property
    def is_payload(self) -> bool:
        """True if it is a payload of a link."""
        return self.cls.place == "link"

    @property
    def body(self) -> FloatArray:
        """Inertial parameters ``(10,)`` of a payload about its link's origin."""
        return pseudo_inertia.parameters_of(np.array([self.values[form.name] for form in self.cls.parameters]))

    @property
    def is_coefficient(self) -> bool:
        """True if it is a single number at a joint that is identified together with the inertias."""
        return issubclass(self.cls, IdentifiedEffect) and self.cls.is_one_number()
