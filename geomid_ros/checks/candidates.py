"""Candidates for what is wrong with a recording, the evidence of each, and the rules by which one is named.

A candidate undoes what may have been done to a recording. It is judged by how much more probable the recording is then,
and named if that repeats: in every recording, or in both halves of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from types import EllipsisType

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.subject import Subject
from geomid_ros.estimation.estimate import SURE
from geomid_ros.types import BoolArray, FloatArray, IntArray

GAIN = 0.25
"""The least that a cause gains [nats per instant]."""
RIVAL = 0.1
"""What explains as much, within this, explains it as well [nats per instant]."""
REASON = 4.0
"""No URDF is wrong by more in its masses: a gain beyond it is a unit."""
TILT = np.radians(25.0)
"""A base that is not level, and a zero that is off, are hardly off by more."""
STEP = 1e-4
"""[rad, m] of derivatives by positions."""
ROUNDS = 3
"""Of a fit that is linearised where it leads."""
_MISFIT = 0.1  # of the gain: a cause that is true explains no channel worse


@dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """What a recording is worth with a candidate undone.

    Attributes:
        log: log evidence of the numbers that were measured.
        sigmas: ``(C,)`` of what is left, in standard deviations of the measured channels.
        opposite: ``(C,)`` whether links take the opposite of what the URDF's do then.
        estimates, deviations: ``(k,)`` what was estimated meanwhile, and how well.
    """

    log: float
    sigmas: FloatArray
    opposite: BoolArray
    estimates: FloatArray = field(default_factory=lambda: np.zeros(0))
    deviations: FloatArray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def mended(mended: Subject, units: FloatArray, found: Evidence | None = None, **estimated: FloatArray) -> Judged:
        """What a mended subject is worth.

        Args:
            mended: with the candidate undone.
            units: ``(C,)`` what one standard deviation of the measured numbers is in its efforts.
            found: its evidence in these units; that of nothing else wrong unless given.
            **estimated: see :class:`Judged`.
        """
        mended = mended.in_units(units)
        found = mended.nominal if found is None else found
        return Judged(log=found.log, sigmas=found.sigmas, opposite=mended.opposite(found), **estimated)


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """What may be wrong.

    Attributes:
        cause: what is said of it, if need be by what was estimated.
        concerned: the channels that it changes.
        read: the subject as it is read with the candidate undone, by which the candidates of a row are ranked, too.
        undo: judges a subject with the candidate undone, where reading it otherwise is not all.
        sizes: ``(C,)`` how many times as large efforts are then.
        sources: ``(C,)`` which measured channel each judged one is.
        allowed: whether what is known beside the evidence allows it.
        alone: whether it may be named by itself, or only beside another cause.
        settled: whether what is known beside the evidence settles it.
        upright: whether links must not be of mass below zero then.
        changes: whether it begins during the recording: then alternate stretches of time are its parts.
    """

    cause: Cause | Callable[[Judged], Cause]
    concerned: Sequence[int]
    read: Callable[[Subject], Subject] | None = None
    undo: Callable[[Subject], Judged] | None = None
    sizes: FloatArray | float = 1.0
    sources: IntArray | EllipsisType = ...
    allowed: bool = True
    alone: bool = True
    settled: bool = False
    upright: bool = False
    changes: bool = False

    def resemblance(self, few: Subject) -> float:
        """That of what is read then and the prediction, see :attr:`Subject.resemblance`."""
        return np.inf if self.read is None else self.read(few).resemblance

    def judged(self, subject: Subject) -> Judged:
        """What a subject is worth with the candidate undone."""
        if self.undo is not None:
            return self.undo(subject)
        read = subject if self.read is None else self.read(subject)
        return Judged.mended(read, self.sizes * subject.spread[self.sources])


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate that was judged on a subject."""

    candidate: Candidate
    subject: Subject
    judged: Judged
    cause: Cause

    @staticmethod
    def of(candidate: Candidate, subject: Subject) -> Tried:
        """Judge a candidate."""
        judged = candidate.judged(subject)
        cause = candidate.cause
        return Tried(candidate, subject, judged, cause if isinstance(cause, Cause) else cause(judged))

    @property
    def allowed(self) -> bool:
        """Whether what is known beside the evidence allows it."""
        opposite = self.judged.opposite[list(self.candidate.concerned)]
        upside_down = self.candidate.upright and 2 * np.count_nonzero(opposite) > len(opposite)
        return self.candidate.allowed and not upside_down

    @property
    def gain(self) -> float:
        """What it gains per instant [nats]."""
        return (self.judged.log - self.subject.nominal.log) / len(self.subject.samples)

    @property
    def is_named(self) -> bool:
        """Whether all speaks for it."""
        return self.allowed and (self.candidate.settled or self.gain > GAIN)

    @property
    def name(self) -> tuple[str, tuple[str, ...]]:
        """The cause's kind and places."""
        return self.cause.kind, self.cause.places

    def repeats(self) -> bool:
        """Whether it explains no channel worse, and every part of the recording asks for it, in sizes of one sign."""
        if self.candidate.settled:
            return True
        before = self.subject.nominal.sigmas[self.candidate.sources]
        worse = np.log(self.judged.sigmas / before)[list(self.candidate.concerned)]
        if np.sum(worse, where=worse > 0.0) > _MISFIT * self.gain:
            return False
        return all(self._repeats(part) for part in self.subject.parts(alternating=self.candidate.changes))

    def _repeats(self, part: Subject) -> bool:
        judged = self.candidate.judged(part)
        off = np.abs(judged.estimates - self.judged.estimates)
        # What noise and friction have in common makes sizes less sure than their deviations say: signs have to agree.
        allowed = np.maximum(np.abs(self.judged.estimates), SURE * judged.deviations)
        return judged.log > part.nominal.log and bool(np.all(off <= allowed))


def decide(tried: Iterable[Tried]) -> tuple[Finding | None, str]:
    """What is wrong: the best cause if it repeats, or what is settled, with its rivals. It is sure unless several other
    places explain as much.

    Returns:
        The finding, and a remark on what is not believed; None and empty if there is none.
    """
    named = sorted((one for one in tried if one.is_named), key=lambda one: -one.gain)
    aside = max((one.gain for one in named if not one.candidate.alone), default=-np.inf)
    # What explains less than what is not named by itself is explained by that.
    causes = [one for one in named if one.candidate.alone and (one.candidate.settled or one.gain > aside - RIVAL)]
    # What explains less than a cause that does not repeat may be explained by the same as that.
    first = [one for number, one in enumerate(causes) if number == 0 or one.candidate.settled]
    first.sort(key=lambda one: -len(one.cause.places))  # one cause for all joints before one for each
    best = next((one for one in first if one.repeats()), None)
    if best is None:
        remark = "in a part of the recording, or at some joints, only: "
        return None, remark + causes[0].cause.sentence if causes else ""
    rivals = {one.name: one for one in reversed(named) if one.gain > best.gain - RIVAL and one.name != best.name}
    elsewhere = {one.cause.places for one in rivals.values() if one.repeats()} - {best.cause.places}
    if not best.candidate.settled and len(elsewhere) > 1:
        return Finding(cause=best.cause, sure=False), ""
    return Finding(cause=best.cause, rivals=tuple(one.cause for one in rivals.values())), ""
