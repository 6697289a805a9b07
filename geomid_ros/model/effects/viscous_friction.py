from __future__ import annotations

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


class ViscousFriction(Effect):
    """Friction in proportion to speed: effort ``c v``."""

    name = "viscous_friction"
    positive = True
    units = ("N m s/rad", "N s/m")

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.velocity
