"""Candidates of the gap: effects at places of a robot, their columns and coefficients, and what these mean."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from geomid_ros.estimation.uncertainty import physical_sensitivity
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.fit import JointFit
from geomid_ros.inference.prior import GAIN, Prior
from geomid_ros.inference.probability import Supports
from geomid_ros.inference.selection import Selection
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    EFFECTS,
    AtSensor,
    Effect,
    IdentifiedEffect,
    LoadEffect,
    MotionEffect,
    OnLink,
    Place,
    Quantity,
    SituationEffect,
    Values,
    joints_of,
)
from geomid_ros.model.effects.parameters import quantities
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REST, SIGN, SMOOTH_SIGN, Column, column_of
from geomid_ros.types import FloatArray

ODDS = 0.01
"""Prior odds of an effect at a place, and that a link has changed. If nothing is known of a robot, default effects of
its joints are as likely as not."""
CLEARLY = 12.0
"""Difference of minus twice a logarithm that occurs by chance once in four hundred."""
_FRACTION = 0.3  # prior standard deviation of a coefficient, of the measurement, where nothing else is known of it
_EXACT = 1e-5  # standard deviation of a sum fixed at zero, relative to the friction: far less than that of any rows
_OF_COUPLED = 0.05  # fraction of the odds, for coupled joints: most joints have separate motors


EffectsByPlace: TypeAlias = Mapping[tuple[str, Place], IdentifiedEffect]
"""Effects with their constants, by name and place."""


def library_columns(model: MeasurementModel) -> tuple[Column, ...]:
    """Columns of samples for the gap workflow: of all effects of joints' motion, with all constants, and of the
    model."""
    columns = [
        column_of(effect, place)
        for cls in EFFECTS.values()
        for effect in cls.grid()
        if isinstance(effect, MotionEffect)
        for place in model.places.of(effect)
    ]
    return tuple(dict.fromkeys([*columns, SIGN, SMOOTH_SIGN, REST, *model.columns]))


@dataclass(frozen=True)
class EffectTerm:
    """Linear coefficient number ``index`` of an effect at a place."""

    effect: Effect
    place: Place
    index: int = 0

    @staticmethod
    def of(coefficient: Coefficient) -> EffectTerm:
        """Create the term of a model's coefficient."""
        return EffectTerm(coefficient.effect, coefficient.place, coefficient.index)

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:  # looked up very often
        return hash((self.effect, self.place, self.index))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints of its place."""
        return joints_of(self.place)


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place, with one value of its grid constant, if it has one.

    Attributes:
        effect: with its constants.
        place: where it acts.
        terms: its coefficients; none for a payload, which is a body.
        in_model: True if the model has it, so that it may have changed.
        odds: prior odds for any constant.
    """

    effect: Effect
    place: Place
    terms: tuple[EffectTerm, ...]
    in_model: bool = False
    odds: float = 1.0

    @staticmethod
    def of(effect: Effect, place: Place, *, in_model: bool = False, ordinary: bool = False) -> Candidate:
        """Create the candidate of an effect at a place; ``ordinary``: True if every joint may well have it."""
        odds = 1.0 if ordinary else ODDS * (_OF_COUPLED if effect.place == "joints" else 1.0)
        return Candidate(effect, place, tuple(_terms(effect, place)), in_model, odds)

    def excludes(self, other: Candidate) -> bool:
        """True if both at once make no sense: same effect and place, one a special case of the other, two payloads."""
        if self.payload is not None and other.payload is not None:
            return True
        return self.includes(other) or other.includes(self)

    def includes(self, other: Candidate) -> bool:
        """True if it is the same with another constant, or if the other is a special case of it."""
        nested = self.effect.contains == other.name and joints_of(self.place) == joints_of(other.place)
        return self.group == other.group or nested

    @cached_property
    def cost(self) -> float:
        """Minus twice the log of the prior odds for its value of the constant."""
        constants = 1 if self.in_model else len(self.effect.grid())
        return -2.0 * float(np.log(self.odds / constants))

    @cached_property
    def prior_std(self) -> tuple[float, ...]:
        """Prior stds of the coefficients about their known values; 0: a fraction of the measurement."""
        return tuple(
            term.effect.default_prior_std[term.index] if term.effect.default_prior_std else 0.0 for term in self.terms
        )

    @property
    def prior_std_fraction(self) -> float:
        """Prior std of the coefficients without another one, as a fraction of the measurement."""
        return self.effect.prior_std_fraction or _FRACTION

    @property
    def rescales(self) -> bool:
        """True if it is a factor on what a channel measures."""
        return self.effect.scales_measurement

    @property
    def confusable_with_payload(self) -> bool:
        """True if a payload may be found in its place."""
        return self.effect.confusable_with_payload

    @property
    def relinearises(self) -> bool:
        """True if all other columns depend on its size."""
        return bool(self.effect.relinearise_beyond)

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if no working robot has it with these ``coefficients (k,)``."""
        return self.effect.is_out_of_range(coefficients)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @cached_property
    def payload(self) -> int | None:
        """Link that carries it, as an index into the identified links; None unless it is a payload."""
        return self.place.link if isinstance(self.place, OnLink) else None

    @property
    def joint(self) -> int | None:
        """Joint at which it acts; None if it acts at none or several."""
        joints = joints_of(self.place)
        return joints[0] if len(joints) == 1 else None

    @cached_property
    def positives(self) -> int:
        """Number of leading coefficients that cannot be negative; effects identified with inertias may have other
        signs."""
        return sum(part.column_positives for part in self.effect.parts) if self.in_model else self.effect.positives

    @cached_property
    def group(self) -> tuple[str, Place]:
        """Name and place. Candidates of one group are the same effect with different constants."""
        return self.name, self.place


EffectsFit: TypeAlias = JointFit[Candidate, EffectTerm]
EffectsPrior: TypeAlias = Prior[EffectTerm]
EffectsSearch: TypeAlias = Selection[Candidate, EffectTerm]
EffectsSupports: TypeAlias = Supports[Candidate, EffectTerm]


def candidates(
    model: MeasurementModel,
    known: Collection[EffectTerm] = (),
    *,
    unknown_joints: bool = True,
    ordinary: EffectsByPlace = MappingProxyType({}),
) -> list[Candidate]:
    """Return all candidates for a robot with its sensors, and the changes of ``known`` effects, which keep their
    constants, as do default effects among the ``ordinary`` ones. ``unknown_joints``: True if nothing is known of its
    joints, so that they may well have default effects.
    The ground loads the joints of a legged robot, too: effects that depend on more than the load are omitted there."""
    has = {(term.effect.name, term.place) for term in known}
    changes = [
        Candidate.of(*pair, in_model=True) for pair in dict.fromkeys((term.effect, term.place) for term in known)
    ]
    result = [c for c in changes if set(c.terms) <= set(known)]
    result += [
        Candidate.of(effect, place, ordinary=unknown_joints and effect.name in DEFAULT_EFFECTS)
        for cls in EFFECTS.values()
        for effect in cls.grid()
        for place in model.places.of(effect)
        if effect.has_columns and (effect.name, place) not in has
        if effect.name not in DEFAULT_EFFECTS or ordinary.get((effect.name, place), effect) == effect
    ]
    if model.legs:
        result = [c for c in result if isinstance(c.effect, LoadEffect) or not isinstance(c.effect, SituationEffect)]
    return sorted(result, key=_order)


def passivity_constraints(terms: Sequence[EffectTerm], values: FloatArray) -> FloatArray:
    """Return passivity constraints that fix a place's sum of dry friction at zero where it is negative.

    Dry friction does not drive a joint, close to standstill either. Rows near a reversal constrain it weakly, and
    depend on the past: their extrapolation to standstill can have the wrong sign. It makes a simulator shake.

    Args:
        terms: terms of the coefficients.
        values: the coefficients ``(k,)``; zero for those that are left out.

    Returns:
        Rows ``(r, k)`` of target 0 and standard deviation 1; r is 0 if the friction of all places is passive.
    """
    places: dict[Place, list[int]] = {}
    for index, term in enumerate(terms):
        if term.effect.is_dry_friction and values[index]:
            places.setdefault(term.place, []).append(index)
    driven = [indices for indices in places.values() if len(indices) > 1 and np.sum(values[indices]) < 0.0]
    rows = np.zeros((len(driven), len(values)))
    for row, indices in zip(rows, driven, strict=True):
        row[indices] = 1.0 / (_EXACT * np.max(np.abs(values[indices])))
    return rows


def _order(candidate: Candidate) -> tuple[int, int]:
    """Sort key: joint by joint; then the whole robot, payloads, sensors."""
    kind = ("joint", "joints", "robot", "commands", "link", "sensor", "base").index(candidate.effect.place)
    return kind, candidate.joint or 0 if kind == 0 else 0


def _terms(effect: Effect, place: Place) -> Iterator[EffectTerm]:
    for part in effect.parts:
        count = len(place.channels) if isinstance(place, AtSensor) else part.count
        yield from (EffectTerm(part, place, index) for index in range(count))


def parameters(
    model: MeasurementModel, found: EffectsFit, candidate: Candidate, log_std: float = 0.0, usual_load: float = 0.0
) -> dict[str, Quantity]:
    """Parameters of a candidate with their standard deviations. ``log_std``: that of the logarithm of the grid
    constant. ``usual_load``: standard deviation of the joint's rigid-body load [N m or N]."""
    if candidate.payload is not None:
        body, spread = _payload(found, candidate.payload)
        stds = np.sqrt(np.maximum(np.diag(spread), 0.0))
        return quantities(candidate.effect.parameters, zip(body, stds, strict=True))
    values = np.array([found.value(term) for term in candidate.terms])
    return _quantities(model, candidate, values, found.covariance_of(candidate.terms), log_std, usual_load)


def known_before(model: MeasurementModel, prior: EffectsPrior, candidate: Candidate, usual_load: float = 0.0) -> Values:
    """Parameters of a candidate in the given model; empty if it had no such effect."""
    if not candidate.terms or not set(candidate.terms) <= set(prior.terms):
        return {}
    values = np.array([prior.value(term) for term in candidate.terms])
    before = _quantities(model, candidate, values, np.zeros((len(values), len(values))), 0.0, usual_load)
    return {name: quantity.value for name, quantity in before.items()}


def _payload(fit: EffectsFit, link: int) -> tuple[FloatArray, FloatArray]:
    """Mass, centre of mass and inertia of a link's payload ``(10,)``, and their covariance ``(10, 10)``, including the
    unknown common gain of the efforts, which scales mass and inertia."""
    place = fit.manifold.links - len(fit.bodies) + fit.bodies.index(link)
    rows = fit.manifold.link(place)
    values = pseudo_inertia.quantities_of(pseudo_inertia.to_parameters(fit.point.pseudo_inertias[place]))
    derivative = physical_sensitivity(fit.point)[place]
    by_gain = GAIN * np.concatenate([values[:1], np.zeros(3), values[4:]])
    return values, derivative @ fit.inverse_from_data[rows, rows] @ derivative.T + np.outer(by_gain, by_gain)


def first_moment(found: EffectsFit, candidate: Candidate) -> dict[str, Quantity]:
    """Mass times centre of mass of a payload, about the origin of its link; empty for other candidates.

    Gravity identifies it even if the mass is not identifiable: where the joints do not move the body up and down, or
    about a centre that stays where it is.
    """
    if candidate.payload is None:
        return {}
    values, covariance = _payload(found, candidate.payload)
    derivative = np.column_stack([values[1:4], values[0] * np.eye(3)])
    stds = np.sqrt(np.diag(derivative @ covariance[:4, :4] @ derivative.T))
    return moment_of(values[0] * values[1:4], stds)


def moment_of(values: FloatArray, stds: FloatArray) -> dict[str, Quantity]:
    """First moment ``(3,)`` [kg m] with its standard deviations, by axis."""
    sizes = zip("xyz", values.tolist(), stds.tolist(), strict=True)
    return {f"m {axis}": Quantity(value, std, "kg m") for axis, value, std in sizes}


def _quantities(
    model: MeasurementModel,
    candidate: Candidate,
    values: FloatArray,
    covariance: FloatArray,
    unsure: float,
    usual_load: float,
) -> dict[str, Quantity]:
    """Parameters for these values of the coefficients; for a sensor one for each axis that it measures."""
    effect, place = candidate.effect, candidate.place
    if not isinstance(place, AtSensor):
        sliding = model.places.slides(place)
        return effect.quantities(values, covariance, sliding=sliding, log_std=unsure, usual_load=usual_load)
    forms = {form.name: form for form in effect.column_parameters}
    measured = [forms[model.channels[channel].axis] for channel in place.channels]
    return quantities(measured, zip(values, np.sqrt(np.diag(covariance)), strict=True))


def settled_by(effect: Effect, joint: str, rivals: Collection[tuple[Effect, str]]) -> str:
    """Recording that would distinguish an effect from its rivals, each with the joint at which it acts."""
    same = [other for rival, other in rivals if type(rival) is type(effect)]
    if effect.place == "link" and same:
        return f"a motion that turns {', '.join(repr(name) for name in (joint, *same))} through their ranges"
    return effect.settled_by
