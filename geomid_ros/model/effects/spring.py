from __future__ import annotations

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


class Spring(Effect):
    """A spring or counterbalance: effort ``k q``; the offset that it comes with, ``-k q_0``, says where it rests."""

    name = "spring"
    positive = True
    units = ("N m/rad", "N/m")

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.position
