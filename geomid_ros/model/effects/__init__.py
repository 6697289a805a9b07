"""Physical effects, one file each. To add one: write its file, name its class in ``EFFECTS``."""

from __future__ import annotations

from geomid_ros.errors import unknown_name
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.effort_offset import EffortOffset
from geomid_ros.model.effects.rotor_inertia import RotorInertia
from geomid_ros.model.effects.viscous_friction import ViscousFriction

__all__ = ["EFFECTS", "Effect", "JointMotion", "effect"]

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
