from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import PairEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray


class CoaxialFriction(PairEffect):
    """Drag between the shafts of two joints, one in the other, that slip by ``s = v_1 - v_2``: efforts ``c s |s|`` and
    ``-c s |s|``."""

    name = "coaxial_friction"
    label = "friction between two shafts"
    meaning = "efforts coefficient s |s| at the first joint and the reverse at the second, with the slip s = v1 - v2"
    parameters = (ParameterForm("coefficient", ("N m s^2/rad^2", "N s^2/m^2"), above=0.0),)
    settled_by = "the two joints alone, then both together"

    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        slip = first.velocity - second.velocity
        drag = slip * np.abs(slip)
        return drag, -drag
