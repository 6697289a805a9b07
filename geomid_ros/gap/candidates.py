"""What may be named: the effects with their places on a robot, the coefficients to fit, and the columns of these."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

from geomid_ros.model.columns import Columns, column_of
from geomid_ros.model.effects import EFFECTS, AtSensor, Effect, MotionEffect, OnLink, Place, joints_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.moving import REST, SIGN, SMOOTH_SIGN

_SCOUTS = 4  # one of so many scanned constants is tried before its name is chosen
_PAYLOAD_PENALTY = 4.0  # mass and centre; what is said of its inertia is little


def library_columns(model: MeasurementModel) -> Columns:
    """The columns of samples for the gap workflow: of all effects of joints' motion, with all constants to choose from,
    and of those that the model has."""
    found = [
        column_of(effect, place)
        for cls in EFFECTS.values()
        for effect in cls.variants()
        if isinstance(effect, MotionEffect)
        for place in model.places.of(effect)
    ]
    return Columns.of([*found, SIGN, SMOOTH_SIGN, REST, *model.columns.columns])


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


@dataclass(frozen=True)
class CurveTerm:
    """One linear coefficient of a free ``curve`` at a joint, the one of ``index``."""

    joint: int
    curve: str
    index: int

    @property
    def joints(self) -> tuple[int, ...]:
        """Its joint."""
        return (self.joint,)


Term: TypeAlias = EffectTerm | CurveTerm


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place, with one value of the constant that is scanned, if there is one.

    Attributes:
        effect: with its constants.
        place: where it acts.
        terms: its coefficients, none for a payload, which is a body.
        penalty: how many parameters it counts for.
        scout: whether it stands for those of its group until one is chosen.
        known: whether the model has it, and it may have changed.
    """

    effect: Effect
    place: Place
    terms: tuple[EffectTerm, ...]
    penalty: float
    scout: bool = True
    known: bool = False

    @staticmethod
    def of(effect: Effect, place: Place, *, scout: bool = True, known: bool = False) -> Candidate:
        """The candidate of an effect at a place."""
        terms = tuple(_terms(effect, place))
        penalty = len(terms) + (effect.scanned != 0.0) if terms else _PAYLOAD_PENALTY
        return Candidate(effect, place, terms, penalty, scout, known)

    def excludes(self, other: Candidate | CurveCandidate) -> bool:
        """Whether both at once make no sense: one name and place, one a special case of the other, two payloads."""
        if isinstance(other, CurveCandidate):
            return False
        if self.payload is not None and other.payload is not None:
            return True
        nested = self.effect.contains == other.name or other.effect.contains == self.name
        return self.group == other.group or (nested and joints_of(self.place) == joints_of(other.place))

    @property
    def name(self) -> str:
        """The effect's."""
        return self.effect.name

    @property
    def payload(self) -> int | None:
        """The identified link, by its place among these, that carries it, of a body."""
        return self.place.link if isinstance(self.place, OnLink) else None

    @property
    def joint(self) -> int | None:
        """The joint at which it acts alone."""
        joints = joints_of(self.place)
        return joints[0] if len(joints) == 1 else None

    @property
    def positives(self) -> int:
        """How many of its coefficients, the first ones, cannot be negative: what is identified along with the inertias
        may have other signs."""
        return sum(part.own_positives for part in self.effect.parts) if self.known else self.effect.positives

    @cached_property
    def group(self) -> tuple[str, Place]:
        """Name and place: candidates of one group are the same effect with other constants."""
        return self.name, self.place


@dataclass(frozen=True, eq=False)
class CurveCandidate:
    """A free curve of one ``variable`` (position, velocity, load, time or a joint's name) at a joint; ``dry``:
    whether it lets the level of dry friction vary, so that its columns add up to that of one level."""

    variable: str
    curve: str
    joint: int
    terms: tuple[Term, ...]
    penalty: float
    dry: bool = False

    def excludes(self, other: Candidate | CurveCandidate) -> bool:
        """Whether it is a curve of the same variable."""
        return isinstance(other, CurveCandidate) and self.group == other.group

    payload = None
    positives = 0

    @property
    def group(self) -> tuple[str, int]:
        """Variable and joint."""
        return self.variable, self.joint


AnyCandidate: TypeAlias = Candidate | CurveCandidate


def candidates(model: MeasurementModel, known: Collection[EffectTerm] = ()) -> list[Candidate]:
    """All names for a robot with its sensors, and changes of what is ``known`` of it: it keeps its constants."""
    has = {(term.effect.name, term.place) for term in known}
    changes = [Candidate.of(*own, known=True) for own in dict.fromkeys((term.effect, term.place) for term in known)]
    found = [c for c in changes if set(c.terms) <= set(known)]
    found += [
        Candidate.of(effect, place, scout=not effect.scanned or index % _SCOUTS == 0)
        for cls in EFFECTS.values()
        for index, effect in enumerate(cls.variants())
        for place in model.places.of(effect)
        if (effect.name, place) not in has
    ]
    return sorted(found, key=_order)


def _order(candidate: Candidate) -> tuple[int, int]:
    """Joint by joint; then the whole robot, payloads, sensors."""
    kind = ("joint", "joints", "robot", "link", "sensor").index(candidate.effect.place)
    return kind, candidate.joint or 0 if kind == 0 else 0


def _terms(effect: Effect, place: Place) -> Iterator[EffectTerm]:
    for part in effect.parts:
        count = len(place.channels) if isinstance(place, AtSensor) else part.count
        yield from (EffectTerm(part, place, index) for index in range(count))
