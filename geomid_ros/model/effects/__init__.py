"""Physical effects, one file each. ``EFFECTS`` are identified at every joint unless the user says otherwise; the others
are named by the gap workflow. To add one to either: write its file, name its class here."""

from __future__ import annotations

from geomid_ros.errors import unknown_name
from geomid_ros.model.effects.backlash import CROSSINGS, Backlash
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.effort_delay import EffortDelay
from geomid_ros.model.effects.effort_gain import EffortGain
from geomid_ros.model.effects.effort_offset import EffortOffset
from geomid_ros.model.effects.gravity_tilt import GravityTilt
from geomid_ros.model.effects.joint_elasticity import JointElasticity
from geomid_ros.model.effects.load_friction import LoadFriction
from geomid_ros.model.effects.rotor_inertia import RotorInertia
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.model.effects.spring import Spring
from geomid_ros.model.effects.stribeck_friction import StribeckFriction
from geomid_ros.model.effects.viscous_friction import ViscousFriction

__all__ = [
    "CROSSINGS",
    "EFFECTS",
    "Backlash",
    "CoulombFriction",
    "Effect",
    "EffortDelay",
    "EffortGain",
    "EffortOffset",
    "GravityTilt",
    "JointElasticity",
    "JointMotion",
    "LoadFriction",
    "RotorInertia",
    "Situation",
    "SituationEffect",
    "Spring",
    "StribeckFriction",
    "ViscousFriction",
    "effect",
]

EFFECTS: dict[str, Effect] = {
    cls.name: cls()
    for cls in (
        ViscousFriction,
        CoulombFriction,
        RotorInertia,
        EffortOffset,
    )
}


def effect(name: str) -> Effect:
    """The effect of that name; an unknown one is answered with the valid names."""
    if name not in EFFECTS:
        raise unknown_name("effect", name, EFFECTS)
    return EFFECTS[name]
