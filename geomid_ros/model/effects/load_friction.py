from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class LoadFriction(SituationEffect):
    """Friction in proportion to the effort that the gear transmits: effort ``c |tau| sign(v)``."""

    name = "load_friction"
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, joint, 0] = np.abs(situation.load[:, joint]) * situation.sign[:, joint]
        return columns
