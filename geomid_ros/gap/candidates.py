"""What may be named: the effects with their places on a robot, the coefficients to fit, and the columns of these."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from geomid_ros.inference.fit import JointFit
from geomid_ros.inference.prior import Prior
from geomid_ros.inference.selection import Selection
from geomid_ros.model.columns import Column, column_of
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    EFFECTS,
    AtSensor,
    Effect,
    LoadEffect,
    MotionEffect,
    OnLink,
    Place,
    SituationEffect,
    joints_of,
)
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import REST, SIGN, SMOOTH_SIGN
from geomid_ros.types import FloatArray

ODDS = 0.01
"""Prior odds of a name at a place, and that a link has been changed; what joints of a robot that nothing is known of
have is as likely as not."""
CLEARLY = 12.0
"""A difference of minus twice a logarithm that is as unlikely by chance as one in four hundred."""
_EXACT = 1e-5  # standard deviation of a sum that is held at zero, of the friction: far less than that of any rows
_OF_COUPLED = 0.05  # of these: most joints have motors of their own


def library_columns(model: MeasurementModel) -> tuple[Column, ...]:
    """The columns of samples for the gap workflow: of all effects of joints' motion, with all constants to choose from,
    and of those that the model has."""
    found = [
        column_of(effect, place)
        for cls in EFFECTS.values()
        for effect in cls.variants()
        if isinstance(effect, MotionEffect)
        for place in model.places.of(effect)
    ]
    return tuple(dict.fromkeys([*found, SIGN, SMOOTH_SIGN, REST, *model.columns]))


@dataclass(frozen=True)
class EffectTerm:
    """One linear coefficient of an effect at a place, the one of ``index``."""

    effect: Effect
    place: Place
    index: int = 0

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:  # it is looked up very often
        return hash((self.effect, self.place, self.index))

    @property
    def joints(self) -> tuple[int, ...]:
        """The joints of its place."""
        return joints_of(self.place)


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place, with one value of the constant that is scanned, if there is one.

    Attributes:
        effect: with its constants.
        place: where it acts.
        terms: its coefficients, none for a payload, which is a body.
        known: whether the model has it, and it may have changed.
        odds: prior odds, with whatever constant.
    """

    effect: Effect
    place: Place
    terms: tuple[EffectTerm, ...]
    known: bool = False
    odds: float = 1.0

    @staticmethod
    def of(effect: Effect, place: Place, *, known: bool = False, ordinary: bool = False) -> Candidate:
        """The candidate of an effect at a place; ``ordinary``: whether it is one that every joint may well have."""
        odds = 1.0 if ordinary else ODDS * (_OF_COUPLED if effect.place == "joints" else 1.0)
        return Candidate(effect, place, tuple(_terms(effect, place)), known, odds)

    def excludes(self, other: Candidate) -> bool:
        """Whether both at once make no sense: one name and place, one a special case of the other, two payloads."""
        if self.payload is not None and other.payload is not None:
            return True
        return self.includes(other) or other.includes(self)

    def includes(self, other: Candidate) -> bool:
        """Whether it is the same with another constant, or the other is a special case of it."""
        nested = self.effect.contains == other.name and joints_of(self.place) == joints_of(other.place)
        return self.group == other.group or nested

    @cached_property
    def cost(self) -> float:
        """Minus twice the logarithm of the prior odds, with its constant."""
        constants = 1 if self.known else len(self.effect.variants())
        return -2.0 * float(np.log(self.odds / constants))

    @cached_property
    def usual(self) -> tuple[float, ...]:
        """Prior standard deviations of the coefficients about what is known; 0 for a share of what is measured."""
        return tuple(term.effect.usual[term.index] if term.effect.usual else 0.0 for term in self.terms)

    @property
    def rescales(self) -> bool:
        """Whether it is a factor on what a channel measures."""
        return self.effect.scales_measurement

    @property
    def confusable_with_payload(self) -> bool:
        """Whether a payload may be found in its place."""
        return self.effect.like_a_payload

    @property
    def relinearises(self) -> bool:
        """Whether all other columns depend on its size."""
        return bool(self.effect.far)

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """Whether no robot that works has it with these ``coefficients (k,)``."""
        return self.effect.is_absurd(coefficients)

    @property
    def name(self) -> str:
        """The effect's."""
        return self.effect.name

    @cached_property
    def payload(self) -> int | None:
        """The identified link, by its place among these, that carries it, of a body."""
        return self.place.link if isinstance(self.place, OnLink) else None

    @property
    def joint(self) -> int | None:
        """The joint at which it acts alone."""
        joints = joints_of(self.place)
        return joints[0] if len(joints) == 1 else None

    @cached_property
    def positives(self) -> int:
        """How many of its coefficients, the first ones, cannot be negative: what is identified along with the inertias
        may have other signs."""
        return sum(part.own_positives for part in self.effect.parts) if self.known else self.effect.positives

    @cached_property
    def group(self) -> tuple[str, Place]:
        """Name and place: candidates of one group are the same effect with other constants."""
        return self.name, self.place


NamesFit: TypeAlias = JointFit[Candidate, EffectTerm]
NamesPrior: TypeAlias = Prior[EffectTerm]
NamesSearch: TypeAlias = Selection[Candidate, EffectTerm]


def candidates(model: MeasurementModel, known: Collection[EffectTerm] = (), *, bare: bool = True) -> list[Candidate]:
    """All names for a robot with its sensors, and changes of what is ``known`` of it: it keeps its constants; ``bare``:
    whether nothing is known of its joints, so that they have what joints have. On its legs the ground loads a robot's
    joints, too: what depends on more than the load itself is none there."""
    has = {(term.effect.name, term.place) for term in known}
    changes = [Candidate.of(*own, known=True) for own in dict.fromkeys((term.effect, term.place) for term in known)]
    found = [c for c in changes if set(c.terms) <= set(known)]
    found += [
        Candidate.of(effect, place, ordinary=bare and effect.name in DEFAULT_EFFECTS)
        for cls in EFFECTS.values()
        for effect in cls.variants()
        for place in model.places.of(effect)
        if (effect.name, place) not in has
    ]
    if model.legs:
        found = [c for c in found if isinstance(c.effect, LoadEffect) or not isinstance(c.effect, SituationEffect)]
    return sorted(found, key=_order)


def not_driving(terms: Sequence[EffectTerm], values: FloatArray) -> FloatArray:
    """Rows that hold the sum of a place's dry friction at zero, where coefficients make it negative.

    Beside standstill, too, dry friction does not drive a joint. Rows near a reversal say little, and depend on the
    past: what is extrapolated from them to standstill can have the wrong sign. A simulator to which that is given
    shakes.

    Args:
        terms: of the coefficients.
        values: the coefficients ``(k,)``; zero for those that are left out.

    Returns:
        Rows ``(r, k)`` of target 0 and standard deviation 1; r is 0 where no joint is driven.
    """
    places: dict[Place, list[int]] = {}
    for index, term in enumerate(terms):
        if term.effect.is_dry_friction and values[index]:
            places.setdefault(term.place, []).append(index)
    driven = [own for own in places.values() if len(own) > 1 and np.sum(values[own]) < 0.0]
    rows = np.zeros((len(driven), len(values)))
    for row, own in zip(rows, driven, strict=True):
        row[own] = 1.0 / (_EXACT * np.max(np.abs(values[own])))
    return rows


def _order(candidate: Candidate) -> tuple[int, int]:
    """Joint by joint; then the whole robot, payloads, sensors."""
    kind = ("joint", "joints", "robot", "commands", "link", "sensor", "base").index(candidate.effect.place)
    return kind, candidate.joint or 0 if kind == 0 else 0


def _terms(effect: Effect, place: Place) -> Iterator[EffectTerm]:
    for part in effect.parts:
        count = len(place.channels) if isinstance(place, AtSensor) else part.count
        yield from (EffectTerm(part, place, index) for index in range(count))
