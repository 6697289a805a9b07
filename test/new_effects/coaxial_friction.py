from __future__ import annotations

from geomid_ros.model.effects.effect import PairEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray


class CoaxialFriction(PairEffect):
    """Friction between the shafts of two joints, one in the other: efforts ``c (v_1 - v_2)`` and ``c (v_2 - v_1)``."""

    name = "coaxial_friction"
    label = "friction between two shafts"
    meaning = "efforts coefficient (v1 - v2) at the first joint and coefficient (v2 - v1) at the second"
    parameters = (ParameterForm("coefficient", ("N m s/rad", "N s/m"), above=0.0),)
    settled_by = "the two joints alone, then both together"

    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        slip = first.velocity - second.velocity
        return slip, -slip
