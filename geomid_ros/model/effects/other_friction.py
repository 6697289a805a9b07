"""Friction beside viscous and Coulomb friction: levelling off with speed, quadratic, and before a joint slides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from geomid_ros.model.effects.dry_friction import SMOOTHINGS, dry_friction
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

    @classmethod
    def states(cls, effects: Sequence[Self], moved: FloatArray, before: FloatArray) -> FloatArray:
        """How far surfaces are bent, z."""
        left = np.exp(-np.abs(moved)[:, None] / np.array([[effect.distance] for effect in effects]))
        bent = (1.0 - left) * np.sign(moved)[:, None]
        for own, share in zip(bent, left, strict=True):
            own[:] = before = own + share * before
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
