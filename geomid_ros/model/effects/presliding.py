from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.coulomb_friction import SMOOTHINGS
from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, JointEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.model.effects.stribeck_friction import dry_friction
from geomid_ros.types import FloatArray

DISTANCES = (3e-3, 1e-2, 3e-2)
"""[rad or m] over which dry friction may change its sign."""


@dataclass(frozen=True)
class Presliding(JointEffect):
    """Dry friction that keeps its sign after a reversal until the joint has slid: ``-2 level sign(v) exp(-d / d_s)``
    after a distance d, with d_s the ``distance`` [rad or m].

    Surfaces bend before they slide (Dahl, "A solid friction model", 1968). Since the last reversal a joint that speeds
    up with the acceleration a has moved by ``d = v^2 / (2 a)``; one that slows down has slid.
    """

    distance: float = 1e-2

    name = "presliding"
    label = "presliding"
    meaning = "effort -2 level sign(v) exp(-v^2/(2 abs(a) distance)) where the joint speeds up"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0),
        ParameterForm("distance", ("rad", "m"), above=0.0),
    )
    settled_by = "this joint back and forth, at several accelerations"
    drift = FRICTION_DRIFT
    constant = "distance"
    adds_up = False

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """One for each of :data:`DISTANCES`."""
        return tuple(cls(distance) for distance in DISTANCES)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """The same."""
        return cls.variants()

    def is_borne_out(self, beside: Mapping[Effect, float]) -> bool:
        """Whether the joint has as much dry friction as keeps its sign, but for the drift of both."""
        return bool(beside[self] <= (1.0 + self.drift) * np.max(dry_friction(beside)))

    def column(self, motion: JointMotion) -> FloatArray:
        v, a = motion.velocity, motion.acceleration
        with np.errstate(divide="ignore", invalid="ignore"):
            held = np.exp(-np.where(a * v > 0.0, v**2 / (2.0 * np.abs(a) * self.distance), np.inf))
        return np.asarray(-2.0 * np.tanh(v / SMOOTHINGS[0]) * held)
