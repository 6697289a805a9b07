from __future__ import annotations

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


class RotorInertia(Effect):
    """Inertia of motor and gears as felt at the joint (armature): effort ``c a``."""

    name = "rotor_inertia"
    positive = True
    units = ("kg m^2", "kg")

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.acceleration
