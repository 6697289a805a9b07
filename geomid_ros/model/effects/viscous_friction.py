from __future__ import annotations

from geomid_ros.model.effects.effect import FRICTION_DRIFT, JointEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray


class ViscousFriction(JointEffect):
    """Friction in proportion to speed: effort ``c v``."""

    name = "viscous_friction"
    label = "viscous friction"
    meaning = "effort coefficient v"
    parameters = (
        ParameterForm(
            "coefficient",
            ("N m s/rad", "N s/m"),
            above=0.0,
            urdf="dynamics/damping",
            mjcf="joint/damping",
            drake="dynamics/damping",
        ),
    )
    settled_by = "this joint at several constant speeds"
    drift = FRICTION_DRIFT

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.velocity
