from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class LoadFriction(SituationEffect):
    """Friction in proportion to the effort that the gear transmits: effort ``c |tau| sign(v)``."""

    name = "load_friction"
    label = "friction in proportion to the load"
    meaning = "effort coefficient |tau| sign(v)"
    parameters = (ParameterForm("coefficient", ("-", "-"), above=0.0, below=1.0),)
    settled_by = "the same motion with a known payload and without"
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, joint, 0] = np.abs(situation.load[:, joint]) * situation.sign[:, joint]
        return columns
