"""Dry friction: its sign, what more there is at slow motion, and what grows with the load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, Effect, JointEffect, LoadEffect
from geomid_ros.model.effects.parameters import EFFORT, ByEffect, ParameterForm, Quantities, Values
from geomid_ros.model.effects.situation import JointMotion, Motion, Place
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
