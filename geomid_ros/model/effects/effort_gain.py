from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class EffortGain(SituationEffect):
    """An effort sensor's error of scale: measured ``(1 + c)`` times the true effort."""

    name = "effort_gain"
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, joint, 0] = situation.predicted[:, joint]
        return columns
