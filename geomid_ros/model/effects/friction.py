"""Joint friction as a function of speed, of load, and of the distance since a reversal."""

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
    """Friction proportional to speed: effort ``c v``."""

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


SMOOTHINGS = tuple(round(0.02 * 2.0 ** (half_octaves / 2), 4) for half_octaves in range(-6, 7))
"""Speeds over which dry friction may change its sign [rad/s or m/s]. Between coarser steps, what the nearest one leaves
near a reversal would pass for presliding or another friction."""
SMOOTHING = ParameterForm("smoothing", ("rad/s", "m/s"), above=0.0, optional=True)
"""The smoothing speed as a parameter."""


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction: effort ``c tanh(v / e)``, the sign of the velocity smoothed over the speed e [rad/s or m/s].

    At speeds below e friction depends on the load and on the past. The smooth sign keeps the equation linear in c and
    gives such samples little weight.
    """

    smoothing: float = 0.02

    name = "coulomb_friction"
    label = "Coulomb friction"
    meaning = "effort level sign(v), its sign tanh(v/smoothing); smoothing is 0.02 by default"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        SMOOTHING,
    )
    stated_parameter_count = 1
    default_constant = SMOOTHING.name
    settled_by = "slow motion of this joint, back and forth at several constant speeds"
    drift = FRICTION_DRIFT
    is_dry_friction = True
    levels_off = True

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Return one for each of :data:`SMOOTHINGS`."""
        return tuple(cls(smoothing) for smoothing in SMOOTHINGS)

    coarse_grid = grid  # the whole grid, because the shape of dry friction is not known beforehand

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.smoothing)

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """Return its level, regardless of load."""
        return np.full(load.shape, abs(coefficient))


SPEEDS = tuple(float(speed) for speed in np.geomspace(0.03, 0.6, 25).round(4))
"""Grid of Stribeck speeds [rad/s or m/s]."""
_TRIED = tuple(round(0.03 * 2.0 ** (half_octaves / 2), 4) for half_octaves in range(7))  # [rad/s or m/s]
_CURVE = np.geomspace(SMOOTHINGS[0], 2.0 * SPEEDS[-1], 100)  # [rad/s or m/s]
_LARGEST_EXCESS = 4.0  # in units of the friction of a fast joint


def dry_friction(beside: Mapping[Effect, float]) -> FloatArray:
    """Sum the friction of a joint's effects that level off, given with coefficients, over a range of speeds."""
    zeros = np.zeros(len(_CURVE))
    motion = JointMotion(np.array([zeros, _CURVE, zeros]))
    dry = [c * e.column(motion) for e, c in beside.items() if isinstance(e, JointEffect) and e.levels_off]
    return np.asarray(np.sum([zeros, *dry], axis=0))


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Dry friction that is larger at slow motion: effort ``sign(v) (level + excess exp(-(v / v_s)^2))``, where v_s is
    the ``speed`` [rad/s or m/s].

    Its column is for the excess. The level is the coefficient of its other part, a :class:`CoulombFriction` with the
    same smooth sign.
    """

    speed: float = 0.1
    smoothing: float = CoulombFriction.smoothing

    name = "stribeck_friction"
    label = "Stribeck friction"
    meaning = "effort sign(v) (level + excess exp(-(v/speed)^2)); smoothing as in coulomb_friction"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, optional=True, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        ParameterForm("excess", EFFORT),  # the coefficient: positive, in the unit of the level
        ParameterForm("speed", ("rad/s", "m/s"), above=0.0),
        SMOOTHING,
    )
    stated_parameter_count = 3
    default_constant = SMOOTHING.name
    settled_by = "this joint at several constant speeds, from creeping to fast"
    drift = FRICTION_DRIFT
    constant = "speed"
    adds_up = False
    contains = "coulomb_friction"
    is_dry_friction = True
    levels_off = True
    positives = 2
    column_positives = 1  # dry friction that sets in gradually is SaturatingFriction

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Return one for each of :data:`SPEEDS`, with the sharpest sign."""
        return tuple(cls(speed, SMOOTHINGS[0]) for speed in SPEEDS)

    @classmethod
    def coarse_grid(cls) -> tuple[Effect, ...]:
        """Return a few speeds, with the default smooth sign of :class:`CoulombFriction`."""
        return tuple(cls(speed) for speed in _TRIED)

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Coulomb friction (the level), and itself (the excess)."""
        return CoulombFriction(self.smoothing), self

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if the excess is many times the level."""
        return bool(coefficients[1] > _LARGEST_EXCESS * coefficients[0])

    def is_supported(self, effects_at_place: Mapping[Effect, float]) -> bool:
        """True if it exceeds the drift, and dry friction falls with speed by more than half of the excess. Otherwise
        the excess only reshapes friction near rest, or compensates another friction."""
        friction, excess = dry_friction(effects_at_place), effects_at_place[self]
        others = {effect: coefficient for effect, coefficient in effects_at_place.items() if effect != self}
        falls = bool(np.max(np.maximum.accumulate(friction) - friction) > 0.5 * excess)
        return falls and excess > FRICTION_DRIFT * float(np.max(dry_friction(others)))

    def column(self, motion: JointMotion) -> FloatArray:
        return CoulombFriction(self.smoothing).column(motion) * np.exp(-((motion.velocity / self.speed) ** 2))

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """Return the excess as its coefficient, and a nonzero level as that of Coulomb friction."""
        instance = cls.from_values(values)
        by_part: dict[Effect, tuple[float, ...]] = {instance: (values["excess"],)}
        if values["level"]:
            by_part[CoulombFriction(instance.smoothing)] = (values["level"],)
        return by_part

    @classmethod
    def updated(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """Take the estimated Coulomb friction as the level."""
        if not {cls.name, CoulombFriction.name} <= found.keys():
            return known, found
        updated, others = super().updated(known, found)
        level = others[CoulombFriction.name]
        return {**updated, **level}, {name: other for name, other in others.items() if other is not level}

    @classmethod
    def holding_friction(cls, values: Values) -> float:
        """Return the excess; 0 if it is negative, as in older files."""
        return max(values["excess"], 0.0)

    def efforts_not_in_mjcf(self, values: Values, motion: Motion, place: Place) -> FloatArray:
        """Return the (negative) change of :meth:`holding_friction` due to motion."""
        full = self.holding_friction(values) * CoulombFriction(self.smoothing).efforts(motion, place)
        return full * np.expm1(-((motion.velocity / self.speed) ** 2))


class LoadFriction(LoadEffect):
    """Friction proportional to the gear load: effort ``c |tau| sign(v)``, tau the effort of the links alone."""

    name = "load_friction"
    label = "load-dependent friction"
    meaning = "effort coefficient |tau| sign(v), tau the effort of the links alone"
    parameters = (ParameterForm("coefficient", ("-", "-"), above=0.0, below=1.0),)
    settled_by = "the same motion with and without a known payload"
    drift = FRICTION_DRIFT
    largest = parameters[0].below  # there the gear transmits nothing

    def column(self, load: FloatArray, sign: FloatArray) -> FloatArray:
        return np.abs(load) * sign

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """Return friction proportional to the load."""
        return abs(coefficient) * np.abs(load)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:
        """Return the coefficient."""
        return values["coefficient"]


SETTING_IN = (0.15, 0.3, 0.6, 1.2)
"""Speeds over which saturating friction may set in, more gradually than dry friction [rad/s or m/s]."""


@dataclass(frozen=True)
class SaturatingFriction(JointEffect):
    """Friction that grows with speed and levels off: effort ``level tanh(v / v_s)``, v_s the ``speed`` [rad/s or m/s].

    Typical of seals, and of lubricant that thins with speed: viscous at slow motion, nearly constant at fast motion.
    """

    speed: float = SETTING_IN[2]

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
    def grid(cls) -> tuple[Effect, ...]:
        """Return the speeds of :data:`SETTING_IN` at which it is neither nearly dry nor nearly viscous friction.
        Changes of those should be reported under the simpler name."""
        return tuple(cls(speed) for speed in SETTING_IN[2:])

    @classmethod
    def coarse_grid(cls) -> tuple[Effect, ...]:
        return tuple(cls(speed) for speed in SETTING_IN)

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.speed)


class QuadraticFriction(JointEffect):
    """Friction proportional to the square of speed: effort ``c v |v|``.

    Drag makes c positive. Lubricant that thins with speed makes it negative, in addition to viscous friction.
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
"""Distances over which dry friction may change its sign [rad or m]."""


@dataclass(frozen=True)
class Presliding(JointEffect):
    """Dry friction that keeps its sign at rest, and after a reversal until the joint has slid: ``level (z - sign(v))``
    in addition to sliding friction, with ``dz/dq = (1 - z sign(v)) / distance`` [1/rad or 1/m].

    Surfaces deflect before they slide (Dahl, "A solid friction model", 1968); z in [-1, 1] is the relative deflection.
    If the past motion is unknown, a joint that speeds up is assumed to have done so at its acceleration a since a
    reversal, so over a distance of ``v^2 / (2 a)``; a joint that slows down is assumed to slide.
    """

    distance: float = DISTANCES[1]

    name = "presliding"
    label = "presliding"
    meaning = "effort level (z - sign(v)), where z bends to sign(v): dz/dq = (1 - z sign(v))/distance"
    parameters = (ParameterForm("level", EFFORT, above=0.0), ParameterForm("distance", ("rad", "m"), above=0.0))
    settled_by = "this joint back and forth, at several accelerations"
    drift = FRICTION_DRIFT
    constant = "distance"
    adds_up = False
    depends_on_past = True

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Return one for each of :data:`DISTANCES`."""
        return tuple(cls(distance) for distance in DISTANCES)

    coarse_grid = grid

    @classmethod
    def states(cls, effects: Sequence[Self], moved: FloatArray, before: FloatArray) -> FloatArray:
        """Return the relative deflections z ``(N, n, J)`` of the surfaces."""
        remaining = np.exp(-np.abs(moved)[:, None] / np.array([[effect.distance] for effect in effects]))
        deflection = (1.0 - remaining) * np.sign(moved)[:, None]
        for state, kept in zip(deflection, remaining, strict=True):
            state[:] = before = state + kept * before
        return np.asarray(deflection)

    def column(self, motion: JointMotion) -> FloatArray:
        sign = np.tanh(motion.velocity / SMOOTHINGS[0])
        z = motion.past.get(self)
        return np.asarray(-2.0 * sign * self._remaining_deflection(motion) if z is None else z - sign)

    def _remaining_deflection(self, motion: JointMotion) -> FloatArray:
        """Return the fraction of the deflection from one side to the other that remains, if the joint slid the other
        way before the reversal."""
        v, a, slid = motion.velocity, motion.acceleration, np.full(motion.velocity.shape, np.inf)
        np.divide(v**2, 2.0 * self.distance * np.abs(a), out=slid, where=a * v > 0.0)
        remaining: FloatArray = np.exp(-slid)
        return remaining
