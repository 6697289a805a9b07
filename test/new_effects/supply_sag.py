from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import RobotEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Motion, Place
from geomid_ros.types import FloatArray


class SupplySag(RobotEffect):
    """A supply that all motors share and load: efforts ``c v |v|``, the last the length of all joints' speeds."""

    name = "supply_sag"
    label = "a supply that sags"
    meaning = "efforts coefficient v sqrt(v1^2 + v2^2 + ...) at all joints"
    parameters = (ParameterForm("coefficient", ("N m s^2/rad^2", "N m s^2/rad^2"), above=0.0),)
    settled_by = "each joint alone, then all together"

    def efforts(self, motion: Motion, place: Place) -> FloatArray:  # noqa: ARG002  # all joints
        result: FloatArray = motion.velocity * np.linalg.norm(motion.velocity, axis=-1, keepdims=True)
        return result
