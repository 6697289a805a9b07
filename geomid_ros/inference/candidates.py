"""Hypotheses of the joint fit: effects at places of a robot, with their columns, prior odds and sizes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import AtSensor, Effect, OnLink, Place, joints_of
from geomid_ros.types import FloatArray

ODDS = 0.01
"""Prior odds of an effect at a place, and that a link has changed. If nothing is known of a robot, default effects of
its joints are as likely as not."""
_FRACTION = 0.3  # prior standard deviation of a coefficient, of the measurement, where nothing else is known of it
_OF_COUPLED = 0.05  # fraction of the odds, for coupled joints: most joints have separate motors
_EXACT = 1e-5  # standard deviation of a sum fixed at zero, relative to the friction: far less than that of any rows


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

    def prior_stds(self, scales: FloatArray) -> FloatArray:
        """Prior stds ``(k,)`` of the coefficients about their known values: where nothing else is known of one, a
        fraction of its scale, ``scales (k,)``, at which its column is as large as the measurement."""
        fraction = self.effect.prior_std_fraction or _FRACTION
        parts = [(term.effect.default_prior_std, term.index) for term in self.terms]
        known = [stds[index] if stds else 0.0 for stds, index in parts]
        return np.array([std or fraction * scale for std, scale in zip(known, scales.tolist(), strict=True)])

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


def _terms(effect: Effect, place: Place) -> Iterator[EffectTerm]:
    for part in effect.parts:
        count = len(place.channels) if isinstance(place, AtSensor) else part.count
        yield from (EffectTerm(part, place, index) for index in range(count))


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
