from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class EffortDelay(SituationEffect):
    """All efforts are measured too late by c [s]: measured(t) = true(t - c)."""

    name = "effort_delay"
    label = "a delay between efforts and motion"
    meaning = "measured effort(t) = true(t - delay), at all joints"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    settled_by = "faster motions"
    place = "robot"
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:  # noqa: ARG002  # all joints alike
        joints = situation.load.shape[1]
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, :joints, 0] = -situation.rate[:, :joints]
        return columns
