from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class StribeckFriction(Effect):
    """What dry friction exceeds its level at slow motion: effort ``c sign(v) exp(-(v / v_s)^2)``, v_s the ``speed``
    [rad/s or m/s], with the sign of :class:`CoulombFriction`, which it comes with."""

    speed: float = 0.1
    smoothing: float = 0.02

    name = "stribeck_friction"
    positive = True
    units = ("N m", "N")

    def column(self, motion: JointMotion) -> FloatArray:
        result: FloatArray = CoulombFriction(self.smoothing).column(motion) * np.exp(
            -((motion.velocity / self.speed) ** 2)
        )
        return result
