from __future__ import annotations

from typing import ClassVar

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


class CoulombFriction(Effect):
    """Dry friction: effort ``c tanh(v / e)``, the sign of the velocity smoothed over the speed e.

    Within e of standstill friction depends on the load and on the past; the smooth sign keeps the equation linear in c
    and lets such instants count little.
    """

    name = "coulomb_friction"
    positive = True
    units = ("N m", "N")
    SMOOTHING: ClassVar[float] = 0.02  # [rad/s or m/s]

    def column(self, motion: JointMotion) -> FloatArray:
        result: FloatArray = np.tanh(motion.velocity / self.SMOOTHING)
        return result
