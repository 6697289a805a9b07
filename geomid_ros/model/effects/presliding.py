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
    """Dry friction that keeps its sign after a reversal until the joint has slid, and at rest: ``level (z - sign(v))``
    beside the friction of a joint that slides, with ``dz/dq = (1 - z sign(v)) / distance`` [1/rad or 1/m].

    Surfaces bend before they slide (Dahl, "A solid friction model", 1968): z is how far, as a share. Where the motion
    before is not known, the joint has speeded up with the acceleration a from a reversal on, and has moved by
    ``v^2 / (2 a)`` since; or it slows down, and slides.
    """

    distance: float = 1e-2

    name = "presliding"
    label = "presliding"
    meaning = "effort level (z - sign(v)), where z bends to sign(v): dz/dq = (1 - z sign(v))/distance"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0),
        ParameterForm("distance", ("rad", "m"), above=0.0),
    )
    settled_by = "this joint back and forth, at several accelerations"
    drift = FRICTION_DRIFT
    constant = "distance"
    adds_up = False
    remembers = True

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

    def states(self, moved: FloatArray, before: FloatArray) -> FloatArray:
        """How far surfaces are bent, z."""
        left = np.exp(-np.abs(moved) / self.distance)
        bent = (1.0 - left) * np.sign(moved)
        for step, share in enumerate(left):
            bent[step] += share * before
            before = bent[step]
        return np.asarray(bent)

    def column(self, motion: JointMotion) -> FloatArray:
        way = np.tanh(motion.velocity / SMOOTHINGS[0])
        bent = motion.past.get(self)
        return np.asarray(-2.0 * way * self._left(motion) if bent is None else bent - way)

    def _left(self, motion: JointMotion) -> FloatArray:
        """The share of the way from one side to the other by which surfaces are still to be bent, if the joint slid one
        way before."""
        v, a, slid = motion.velocity, motion.acceleration, np.full(motion.velocity.shape, np.inf)
        np.divide(v**2, 2.0 * self.distance * np.abs(a), out=slid, where=a * v > 0.0)
        left: FloatArray = np.exp(-slid)
        return left
