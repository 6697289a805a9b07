"""Friction of a joint: as a function of speed, of the load, and of how far it has slid since a reversal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, JointEffect, LoadEffect
from geomid_ros.model.effects.parameters import EFFORT, ByEffect, ParameterForm, Quantities, Values
from geomid_ros.model.effects.situation import JointMotion, Motion, Place
from geomid_ros.types import FloatArray


class ViscousFriction(JointEffect):
    """Friction in proportion to speed: effort ``c v``."""

    name = "viscous_friction"
    label = "viscous friction"
    meaning = "effort coefficient v"
    parameters = (
        ParameterForm(
            "coefficient",
            ("N m s/rad", "N s/m"),
            above=0.0,
            urdf="dynamics/damping",
            mjcf="joint/damping",
            drake="dynamics/damping",
        ),
    )
    settled_by = "this joint at several constant speeds"
    drift = FRICTION_DRIFT

    def column(self, motion: JointMotion) -> FloatArray:
        return motion.velocity


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


SPEEDS = tuple(float(speed) for speed in np.geomspace(0.03, 0.6, 25).round(4))
"""[rad/s or m/s] to choose Stribeck's speed from."""
_TRIED = (0.03, 0.06, 0.12, 0.25)  # [rad/s or m/s]
_CURVE = np.geomspace(SMOOTHINGS[0], 2.0 * SPEEDS[-1], 100)  # [rad/s or m/s]
_LARGEST_EXCESS = 4.0  # of the friction of a fast joint


def dry_friction(beside: Mapping[Effect, float]) -> FloatArray:
    """What the effects at a joint that level off, with their coefficients, add up to over a range of speeds."""
    still = np.zeros(len(_CURVE))
    motion = JointMotion(np.array([still, _CURVE, still]))
    dry = [c * e.column(motion) for e, c in beside.items() if isinstance(e, JointEffect) and e.levels_off]
    return np.asarray(np.sum([still, *dry], axis=0))


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Dry friction that is larger at slow motion: effort ``sign(v) (level + excess exp(-(v / v_s)^2))``, v_s the
    ``speed`` [rad/s or m/s].

    Its own column is that of the excess; it comes with :class:`CoulombFriction` of the same smooth sign, whose
    coefficient is the level.
    """

    speed: float = 0.1
    smoothing: float = 0.02

    name = "stribeck_friction"
    label = "Stribeck friction"
    meaning = "effort sign(v) (level + excess exp(-(v/speed)^2)); smoothing as in coulomb_friction"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, optional=True, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        ParameterForm("excess", EFFORT),  # the coefficient: positive and in units as the level
        ParameterForm("speed", ("rad/s", "m/s"), above=0.0),
        SMOOTHING,
    )
    said_first = 3
    usual_constant = SMOOTHING.name
    settled_by = "this joint at several constant speeds, from creeping to fast"
    drift = FRICTION_DRIFT
    constant = "speed"
    adds_up = False
    contains = "coulomb_friction"
    is_dry_friction = True
    levels_off = True

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """One for each of :data:`SPEEDS`, with the sharpest sign."""
        return tuple(cls(speed, SMOOTHINGS[0]) for speed in SPEEDS)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """Some speeds, with the smooth sign that :class:`CoulombFriction` has by itself."""
        return tuple(cls(speed) for speed in _TRIED)

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Coulomb friction, and the excess."""
        return CoulombFriction(self.smoothing), self

    @property
    def positives(self) -> int:
        """Level and excess."""
        return 2

    @property
    def own_positives(self) -> int:
        """The excess: dry friction that sets in gradually is :class:`SaturatingFriction`."""
        return 1

    def is_absurd(self, coefficients: FloatArray) -> bool:
        """Whether the excess is many times the level."""
        return bool(coefficients[1] > _LARGEST_EXCESS * coefficients[0])

    def is_borne_out(self, beside: Mapping[Effect, float]) -> bool:
        """Whether dry friction falls with speed by more than half of the excess: otherwise it changes its shape near
        rest, or makes up for another friction."""
        friction = dry_friction(beside)
        return bool(np.max(np.maximum.accumulate(friction) - friction) > 0.5 * beside[self])

    def column(self, motion: JointMotion) -> FloatArray:
        return CoulombFriction(self.smoothing).column(motion) * np.exp(-((motion.velocity / self.speed) ** 2))

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """The level, if there is one, is Coulomb friction, the excess its own."""
        own = cls.from_values(values)
        found: dict[Effect, tuple[float, ...]] = {own: (values["excess"],)}
        if values["level"]:
            found[CoulombFriction(own.smoothing)] = (values["level"],)
        return found

    @classmethod
    def refined(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """The estimated Coulomb friction is the level."""
        if not {cls.name, CoulombFriction.name} <= found.keys():
            return known, found
        own, left = super().refined(known, found)
        level = left[CoulombFriction.name]
        return {**own, **level}, {name: other for name, other in left.items() if other is not level}

    @classmethod
    def holding_friction(cls, values: Values) -> float:
        """All of the excess holds a joint at rest. One below zero, of an older file, takes off nothing."""
        return max(values["excess"], 0.0)

    def unsaid_efforts(self, values: Values, motion: Motion, place: Place) -> FloatArray:
        """What the motion takes off :meth:`holding_friction`."""
        full = self.holding_friction(values) * CoulombFriction(self.smoothing).efforts(motion, place)
        return full * np.expm1(-((motion.velocity / self.speed) ** 2))


class LoadFriction(LoadEffect):
    """Friction in proportion to the effort that the gear transmits: effort ``c |tau| sign(v)``."""

    name = "load_friction"
    label = "load-dependent friction"
    meaning = "effort coefficient |tau| sign(v)"
    parameters = (ParameterForm("coefficient", ("-", "-"), above=0.0, below=1.0),)
    settled_by = "the same motion with and without a known payload"
    drift = FRICTION_DRIFT
    largest = 1.0  # nothing of the effort would pass

    @property
    def positives(self) -> int:
        """It is no motor."""
        return 1

    def column(self, load: FloatArray, sign: FloatArray) -> FloatArray:
        return np.abs(load) * sign

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """In proportion to the load."""
        return abs(coefficient) * np.abs(load)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:
        """The coefficient."""
        return values["coefficient"]


SETTING_IN = (0.15, 0.3, 0.6, 1.2)
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
    parameters = (ParameterForm("level", EFFORT, above=0.0), ParameterForm("speed", ("rad/s", "m/s"), above=0.0))
    settled_by = "this joint at several constant speeds, up to its fastest"
    drift = FRICTION_DRIFT
    constant = "speed"
    adds_up = False
    levels_off = True

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """Of :data:`SETTING_IN` those at which it is neither nearly dry nor nearly viscous friction: of one of these a
        change goes by the simpler name."""
        return tuple(cls(speed) for speed in SETTING_IN[2:])

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        return tuple(cls(speed) for speed in SETTING_IN)

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
    parameters = (ParameterForm("level", EFFORT, above=0.0), ParameterForm("distance", ("rad", "m"), above=0.0))
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
