from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, JointEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray

SPEEDS = (0.15, 0.3, 0.6, 1.2)
"""[rad/s or m/s] over which it may set in: slower than dry friction does."""


@dataclass(frozen=True)
class SaturatingFriction(JointEffect):
    """Friction that grows with speed and levels off: effort ``level tanh(v / v_s)``, v_s the ``speed`` [rad/s or m/s].

    Lubricant that grows thinner with speed, and seals, rub like this: viscous at slow motion, nearly constant at fast
    motion.
    """

    speed: float = 0.6

    name = "saturating_friction"
    label = "friction that levels off with speed"
    meaning = "effort level tanh(v/speed)"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0),
        ParameterForm("speed", ("rad/s", "m/s"), above=0.0),
    )
    settled_by = "this joint at several constant speeds, up to its fastest"
    drift = FRICTION_DRIFT
    constant = "speed"
    adds_up = False
    levels_off = True

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """Of :data:`SPEEDS` those at which it is neither nearly dry nor nearly viscous friction: of one of these a
        change goes by the simpler name."""
        return tuple(cls(speed) for speed in SPEEDS[2:])

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        return tuple(cls(speed) for speed in SPEEDS)

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.speed)
