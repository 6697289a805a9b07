from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.types import FloatArray


class EffortOffset(Effect):
    """A constant error of the effort measurement."""

    name = "effort_offset"
    label = "an offset of the measured effort"
    meaning = "measured effort = true + offset"
    parameters = (ParameterForm("offset", EFFORT),)
    settled_by = "a recording in which gravity loads this joint to both sides"

    def column(self, motion: JointMotion) -> FloatArray:
        return np.ones_like(motion.velocity)
