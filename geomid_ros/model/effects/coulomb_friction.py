from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, JointEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray

SMOOTHINGS = (0.003, 0.01, 0.02, 0.05, 0.1, 0.2)
"""[rad/s or m/s] over which dry friction may change its sign."""
SMOOTHING = ParameterForm("smoothing", ("rad/s", "m/s"), above=0.0, optional=True)
"""The same as a parameter."""


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction: effort ``c tanh(v / e)``, the sign of the velocity smoothed over the speed e [rad/s or m/s].

    Within e of standstill friction depends on the load and on the past; the smooth sign keeps the equation linear in c
    and lets such instants count little.
    """

    smoothing: float = 0.02

    name = "coulomb_friction"
    label = "Coulomb friction"
    meaning = "effort level sign(v), its sign tanh(v/smoothing); smoothing is 0.02 by default"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        SMOOTHING,
    )
    said_first = 1
    usual_constant = SMOOTHING.name
    settled_by = "slow motion of this joint, back and forth at several constant speeds"
    drift = FRICTION_DRIFT
    is_dry_friction = True
    levels_off = True

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """One for each of :data:`SMOOTHINGS`."""
        return tuple(cls(smoothing) for smoothing in SMOOTHINGS)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """The same: the shape of dry friction is not known before."""
        return cls.variants()

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.smoothing)

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """Its level."""
        return np.full(load.shape, abs(coefficient))
