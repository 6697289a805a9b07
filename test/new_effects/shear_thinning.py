from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class ShearThinning(JointEffect):
    """Friction of a lubricant that grows thin at speed: effort ``c v / (1 + (v / v_0)^2)``, v_0 the ``speed``."""

    speed: float = 0.5

    name = "shear_thinning"
    label = "a lubricant that grows thin"
    meaning = "effort coefficient v / (1 + (v/speed)^2)"
    parameters = (
        ParameterForm("coefficient", ("N m s/rad", "N s/m"), above=0.0),
        ParameterForm("speed", ("rad/s", "m/s"), above=0.0),
    )
    settled_by = "runs of this joint at several constant speeds, up to its fastest"
    constant = "speed"
    adds_up = False

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        return tuple(cls(float(speed)) for speed in np.geomspace(0.1, 1.6, 13))

    def column(self, motion: JointMotion) -> FloatArray:
        result: FloatArray = motion.velocity / (1.0 + (motion.velocity / self.speed) ** 2)
        return result
