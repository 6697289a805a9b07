from __future__ import annotations

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class GravityTilt(SituationEffect):
    """The base is turned by the rotation vector (c_x, c_y, 0) [rad]: gravity in the base frame is ``R^T g``."""

    name = "gravity_tilt"
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:  # noqa: ARG002  # the whole robot
        return situation.by_tilt
