from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class StribeckFriction(Effect):
    """What dry friction exceeds its level at slow motion: effort ``c sign(v) exp(-(v / v_s)^2)``, v_s the ``speed``
    [rad/s or m/s], with the sign of :class:`CoulombFriction`, which it comes with."""

    speed: float = 0.1
    smoothing: float = 0.02

    name = "stribeck_friction"
    label = "Stribeck friction"
    meaning = "effort sign(v) (level + excess exp(-(v/speed)^2))"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        ParameterForm("excess", EFFORT),  # the coefficient: positive and in units as the level
        ParameterForm("speed", ("rad/s", "m/s"), above=0.0),
    )
    settled_by = "runs of this joint at constant speeds from creeping to fast"
    adds_up = False

    def column(self, motion: JointMotion) -> FloatArray:
        result: FloatArray = CoulombFriction(self.smoothing).column(motion) * np.exp(
            -((motion.velocity / self.speed) ** 2)
        )
        return result
