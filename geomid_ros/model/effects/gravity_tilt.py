from __future__ import annotations

import math

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class GravityTilt(SituationEffect):
    """The base is turned by the rotation vector (c_x, c_y, 0) [rad]: gravity in the base frame is ``R^T g``."""

    name = "gravity_tilt"
    label = "a base that is not level"
    meaning = "gravity in the base frame is R^T g, R the rotation by the vector (tilt_x, tilt_y, 0)"
    parameters = tuple(
        ParameterForm(name, ("rad", "rad"), above=-math.pi, below=math.pi, mjcf="option/gravity")
        for name in ("tilt_x", "tilt_y")
    )
    settled_by = "a slow motion of the first joint through its range with the arm stretched out"
    place = "robot"
    positive = False

    def columns(self, situation: Situation, joint: int) -> FloatArray:  # noqa: ARG002  # the whole robot
        return situation.by_tilt
