from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, JointEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray


class QuadraticFriction(JointEffect):
    """Friction in proportion to the square of speed: effort ``c v |v|``.

    Drag makes c positive; lubricant that grows thinner with speed makes it negative, beside viscous friction.
    """

    name = "quadratic_friction"
    label = "friction proportional to the square of the speed"
    meaning = "effort coefficient v |v|"
    parameters = (ParameterForm("coefficient", ("N m s^2/rad^2", "N s^2/m^2")),)
    settled_by = "this joint at several constant speeds, up to its fastest"
    drift = FRICTION_DRIFT

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.velocity * np.abs(motion.velocity)
