from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointMotion
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """Dry friction: effort ``c tanh(v / e)``, the sign of the velocity smoothed over the speed e [rad/s or m/s].

    Within e of standstill friction depends on the load and on the past; the smooth sign keeps the equation linear in c
    and lets such instants count little.
    """

    smoothing: float = 0.02

    name = "coulomb_friction"
    label = "Coulomb friction"
    meaning = "effort level sign(v)"
    parameters = (ParameterForm("level", EFFORT, above=0.0, urdf="dynamics/friction", mjcf="joint/frictionloss"),)
    settled_by = "a slow motion of this joint to and fro, at several constant speeds"

    def column(self, motion: JointMotion) -> FloatArray:
        result: FloatArray = np.tanh(motion.velocity / self.smoothing)
        return result
