from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class EffortGain(SituationEffect):
    """An effort sensor's error of scale: measured ``(1 + c)`` times the true effort."""

    name = "effort_gain"
    label = "a wrong gain of the measured effort"
    meaning = "measured effort = gain true"
    parameters = (ParameterForm("gain", ("-", "-"), above=0.0),)
    settled_by = "the same motion with a known payload"
    adds_up = False
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, joint, 0] = situation.predicted[:, joint]
        return columns
