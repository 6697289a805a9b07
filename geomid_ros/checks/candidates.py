"""Candidates for what is wrong with a recording, the evidence of each, and the rules by which one is named.

A candidate undoes what may have been done to a recording. It is judged by how much more probable the recording is then,
and named if that repeats: in every recording, or in both halves of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.subject import Subject
from geomid_ros.types import BoolArray, FloatArray, IntArray

FOLLOWS = 0.85
"""A channel follows the model if no more than this share of its standard deviation is left."""
_MOST_LEFT = {"sign": FOLLOWS, "order": FOLLOWS, "names": 0.7}  # wrists are alike: of them all would fit a little
_BETTER = 0.75
_SCATTER = 0.15  # of the log of a standard deviation over some 50 independent instants, one and a half standard errors
_MISFIT = 0.1  # of the gain: a cause that is true explains no channel worse
_GAIN = 0.25  # nats per instant
GAIN_OF_MANY = 0.4
"""The least gain of what is one of very many, as wrists are alike [nats per instant]."""
_OF_MANY = ("order", "names", "zero", "axis", "absolute", "position", "coupled", "time")
_OVERWHELMING = 0.5  # nats per instant: then it may be the links alone that become much more probable
_LEAST = 10.0  # nats in all
_RIVAL = 0.1  # nats per instant
_AGREE = 3.0  # standard deviations of the size in a part from that of the whole
_NO_SIZES = np.zeros(0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """What a recording is worth with a candidate undone.

    Attributes:
        log: log evidence of the numbers that were measured.
        sigmas: ``(C,)`` of what is left, in standard deviations of the measured channels.
        opposite: ``(C,)`` whether links take the opposite of what the URDF's do then.
        sizes, deviations: ``(k,)`` what was estimated meanwhile, and how well.
    """

    log: float
    sigmas: FloatArray
    opposite: BoolArray
    sizes: FloatArray = field(default_factory=lambda: _NO_SIZES)
    deviations: FloatArray = field(default_factory=lambda: _NO_SIZES)

    @staticmethod
    def mended(
        mended: Subject,
        units: FloatArray,
        found: Evidence | None = None,
        volume: float = 0.0,
        sizes: Sequence[float] = (),
        deviations: Sequence[float] = (),
    ) -> Judged:
        """What a mended subject is worth.

        Args:
            mended: with the candidate undone.
            units: ``(C,)`` what one standard deviation of the measured numbers is in its efforts.
            found: its evidence; that of nothing else wrong unless given.
            volume: log of the determinant by which the mending of numbers changes volumes, beyond that of ``units``.
            sizes, deviations: see :class:`Judged`.
        """
        found = found or mended.nominal
        ratios = mended.spread / units
        log = found.log - len(mended.samples) * float(np.sum(np.log(ratios))) + volume
        opposite = mended.opposite(found)
        return Judged(
            log=log,
            sigmas=found.sigmas * ratios,
            opposite=opposite,
            sizes=np.array(sizes),
            deviations=np.array(deviations),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """What may be wrong.

    Attributes:
        undo: judges a subject with the candidate undone.
        cause: what is said of it, if need be by what was estimated.
        concerned: the channels that it changes.
        choices: among how many of its kind it was chosen.
        sources: ``(C,)`` which measured channel each judged one is; None if each is its own.
        allowed: whether what is known beside the evidence allows it.
        alone: whether it may be named by itself, or only beside another cause.
        settled: whether what is known beside the evidence settles it.
        upright: whether links must not be of mass below zero then.
        changes: whether it begins during the recording: then alternate stretches of time are its parts.
        subject: what it is judged on, if that is not all of the recording.
    """

    undo: Callable[[Subject], Judged]
    cause: Cause | Callable[[Judged], Cause]
    concerned: Sequence[int]
    choices: int = 1
    sources: IntArray | None = None
    allowed: bool = True
    alone: bool = True
    settled: bool = False
    upright: bool = False
    changes: bool = False
    subject: Subject | None = None


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate that was judged on a subject."""

    candidate: Candidate
    subject: Subject
    judged: Judged
    cause: Cause

    @staticmethod
    def of(candidate: Candidate, subject: Subject) -> Tried:
        """Judge a candidate on its own subject, or on this one."""
        subject = candidate.subject or subject
        judged = candidate.undo(subject)
        cause = candidate.cause
        return Tried(candidate, subject, judged, cause if isinstance(cause, Cause) else cause(judged))

    @property
    def allowed(self) -> bool:
        """Whether what is known beside the evidence allows it."""
        concerned = list(self.candidate.concerned)
        upside_down = self.candidate.upright and bool(np.any(self.judged.opposite[concerned]))
        return self.candidate.allowed and not upside_down

    @property
    def gain(self) -> float:
        """What it gains per instant, less what the choice among many costs [nats]."""
        score = self.judged.log - float(np.log(self.candidate.choices))
        return (score - self.subject.nominal.log) / len(self.subject.samples)

    @property
    def is_better(self) -> bool:
        """Whether the evidence asks for it."""
        least = GAIN_OF_MANY if self.cause.kind in _OF_MANY else _GAIN
        return self.gain > least and self.gain * len(self.subject.samples) > _LEAST

    @property
    def _before_and_after(self) -> tuple[FloatArray, FloatArray]:
        """What is left of the channels concerned without it and with it, of each as it was measured."""
        concerned, sources = list(self.candidate.concerned), self.candidate.sources
        before = self.subject.nominal.sigmas if sources is None else self.subject.nominal.sigmas[sources]
        return before[concerned], self.judged.sigmas[concerned]

    @property
    def is_consistent(self) -> bool:
        """Whether what it explains worse than it is, of the channels concerned, is little beside what it gains."""
        before, after = self._before_and_after
        worse = np.log(after / before)
        return float(np.sum(worse[worse > _SCATTER])) < _MISFIT * self.gain

    @property
    def explains(self) -> bool:
        """Whether the channels concerned follow the model then, and one of them much better than as it is."""
        before, after = self._before_and_after
        if self.cause.kind in _MOST_LEFT and np.any(after > _MOST_LEFT[self.cause.kind]):
            return False
        if self.cause.kind == "gain":  # of which the friction that is fitted as it is explains as much
            return bool(np.any(after < FOLLOWS))
        return bool(np.any(after < _BETTER * before)) or self.gain > _OVERWHELMING

    @property
    def is_named(self) -> bool:
        """Whether all speaks for it."""
        if not self.allowed:
            return False
        return self.candidate.settled or (self.is_better and self.is_consistent and self.explains)

    def repeats(self) -> bool:
        """Whether every part of the recording asks for it, too, with sizes that are those of all of it."""
        if self.candidate.settled:
            return True
        return all(self._repeats(part) for part in self.subject.parts(alternating=self.candidate.changes))

    def _repeats(self, part: Subject) -> bool:
        judged = self.candidate.undo(part)
        off = np.abs(judged.sizes - self.judged.sizes)
        # What changes is measured by the variation of each part: there the sign has to agree.
        allowed = np.abs(self.judged.sizes) if self.candidate.changes else _AGREE * judged.deviations
        return judged.log > part.nominal.log and bool(np.all(off <= allowed))


def decide(tried: Iterable[Tried]) -> tuple[Finding, Tried] | None:
    """What is wrong: the best candidate if all speaks for it, told as suspected if only the evidence does."""
    tried = list(tried)
    aside = [one.gain for one in tried if not one.candidate.alone and one.is_named]
    least = max(aside, default=-np.inf) - _RIVAL  # what explains less is explained by what is not named
    ordered = sorted((o for o in tried if o.candidate.settled or o.gain > least), key=lambda one: -one.gain)
    named = [one for one in ordered if one.is_named]
    better = [one for one in ordered if one.allowed and one.candidate.alone and one.is_better]
    misfits = [one for one in better if not one.is_consistent]
    better = [one for one in better if one not in misfits and not any(_contradicts(o, one) for o in misfits)]
    best = next((one for one in named if one in better and not any(_contradicts(o, one) for o in better)), None)
    if best is None and not any(one.candidate.alone and one.cause.kind != "gain" for one in named):
        best = next((one for one in named if one.candidate.settled), None)
    if best is None:
        return (Finding(cause=better[0].cause, sure=False), better[0]) if better else None
    near = best.gain - _RIVAL
    rivals = {(one.cause.kind, one.cause.places): one.cause for one in reversed(named) if one.gain > near}
    rivals.pop((best.cause.kind, best.cause.places))
    return Finding(cause=best.cause, rivals=tuple(rivals.values())), best


def _contradicts(other: Tried, best: Tried) -> bool:
    """Whether a better one, which is not named, is about the same channels."""
    return other.gain > best.gain and not set(best.candidate.concerned).isdisjoint(other.candidate.concerned)
