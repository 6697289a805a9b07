from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.types import FloatArray


class EffortOffset(Effect):
    """A constant error of the effort measurement."""

    name = "effort_offset"
    positive = False
    units = ("N m", "N")

    def column(self, motion: JointMotion) -> FloatArray:
        return np.ones_like(motion.velocity)
