from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class EffortDelay(SituationEffect):
    """All efforts are measured too late by c [s]: measured(t) = true(t - c)."""

    name = "effort_delay"
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:  # noqa: ARG002  # all joints alike
        joints = situation.load.shape[1]
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, :joints, 0] = -situation.rate[:, :joints]
        return columns
