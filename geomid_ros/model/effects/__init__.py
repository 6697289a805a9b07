"""Physical effects, one file each: what is listed here is known everywhere."""

from __future__ import annotations

from geomid_ros.errors import unknown_name
from geomid_ros.model.effects.backlash import Backlash
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effect import (
    Effect,
    Hinge,
    IdentifiedEffect,
    JointEffect,
    MotionEffect,
    PairEffect,
    RobotEffect,
    SensorEffect,
    SituationEffect,
)
from geomid_ros.model.effects.effort_delay import EffortDelay
from geomid_ros.model.effects.effort_gain import EffortGain
from geomid_ros.model.effects.effort_offset import EffortOffset
from geomid_ros.model.effects.gravity_tilt import GravityTilt
from geomid_ros.model.effects.joint_elasticity import JointElasticity
from geomid_ros.model.effects.known import KnownEffect, ModelEffect
from geomid_ros.model.effects.load_friction import LoadFriction
from geomid_ros.model.effects.parameters import ParameterForm, Quantity, Values
from geomid_ros.model.effects.payload import Payload
from geomid_ros.model.effects.places import (
    AtJoint,
    AtJoints,
    AtSensor,
    OnLink,
    OnRobot,
    Place,
    PlaceKind,
    joint_of,
    joints_of,
)
from geomid_ros.model.effects.rotor_inertia import RotorInertia
from geomid_ros.model.effects.situation import JointMotion, Motion, Situation
from geomid_ros.model.effects.spring import Spring
from geomid_ros.model.effects.stribeck_friction import StribeckFriction
from geomid_ros.model.effects.viscous_friction import ViscousFriction
from geomid_ros.model.effects.wrench_offset import WrenchOffset

__all__ = [
    "DEFAULT_EFFECTS",
    "EFFECTS",
    "AtJoint",
    "AtJoints",
    "AtSensor",
    "Effect",
    "Hinge",
    "IdentifiedEffect",
    "JointEffect",
    "JointMotion",
    "KnownEffect",
    "ModelEffect",
    "Motion",
    "MotionEffect",
    "OnLink",
    "OnRobot",
    "PairEffect",
    "ParameterForm",
    "Place",
    "PlaceKind",
    "Quantity",
    "RobotEffect",
    "SensorEffect",
    "Situation",
    "SituationEffect",
    "Values",
    "effect_class",
    "identifiable",
    "identified_effect",
    "joint_of",
    "joints_of",
    "register",
    "values_of",
]

DEFAULT_EFFECTS = ("viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset")
"""Names of the effects that are identified at every joint unless the user says otherwise."""

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


for _effect in (
    ViscousFriction,
    RotorInertia,
    EffortOffset,
    Spring,
    CoulombFriction,
    StribeckFriction,
    LoadFriction,
    EffortGain,
    JointElasticity,
    Backlash,
    EffortDelay,
    GravityTilt,
    Payload,
    WrenchOffset,
):
    register(_effect)


def effect_class(name: str) -> type[Effect]:
    """The effect of that name. Raises InputError with the valid names for an unknown one."""
    if name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS)
    return EFFECTS[name]


def values_of(known: ModelEffect) -> dict[str, float]:
    """An effect's parameters without their units; what may be left out is zero."""
    optional = {form.name: 0.0 for form in effect_class(known.effect).parameters if form.optional}
    return optional | {name: quantity.value for name, quantity in known.parameters.items()}


def identifiable() -> dict[str, IdentifiedEffect]:
    """The effects that can be identified along with the inertias, by name: linear in their coefficients, and not made
    of others."""
    instances = {name: cls() for name, cls in EFFECTS.items() if issubclass(cls, IdentifiedEffect)}
    return {name: effect for name, effect in instances.items() if effect.parts == (effect,)}


def identified_effect(name: str) -> IdentifiedEffect:
    """The effect of that name that can be identified. Raises InputError with the valid names for an unknown one."""
    known = identifiable()
    if name not in known:
        raise unknown_name("effect", name, known)
    return known[name]
