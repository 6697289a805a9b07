"""Candidates for what is wrong with a recording, the evidence of each, and the rules by which one is named.

A candidate undoes what may have been done to a recording. It is judged by how much more probable the recording is then,
and named if that repeats: in every recording, or in both halves of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import EllipsisType

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.subject import Subject
from geomid_ros.estimation.uncertain_inertia import STDS_OF_95
from geomid_ros.inference.probability import shares
from geomid_ros.types import FloatArray, IntArray

PROBABLE = 0.9
"""The least probability of what is named. A recording is worth as many independent instants as the shortest has that is
judged."""
REASON = 4.0
"""No URDF is wrong by more in its masses: a gain beyond it is a unit."""
TILT = np.radians(25.0)
"""A base that is not level, and a zero that is off, are hardly off by more."""
STEP = 1e-4
"""[rad, m] of derivatives by positions."""
ROUNDS = 3
"""Of a fit that is linearised where it leads."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """What a recording is worth with a candidate undone.

    Attributes:
        log: log evidence of the numbers that were measured.
        sigmas: ``(C,)`` of what is left, in standard deviations of the measured channels.
        estimates, deviations: ``(k,)`` what was estimated meanwhile, and how well.
    """

    log: float
    sigmas: FloatArray
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
        found = mended.in_units(units).nominal if found is None else found
        return Judged(log=found.log, sigmas=found.sigmas, **estimated)


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """What may be wrong.

    Attributes:
        cause: what is said of it, if need be by what was estimated.
        concerned: the channels that it changes, all unless given.
        read: the subject as it is read with the candidate undone, by which the candidates of a row are ranked, too.
        undo: judges a subject with the candidate undone, where reading it otherwise is not all.
        sizes: ``(C,)`` how many times as large efforts are then.
        sources: ``(C,)`` which measured channel each judged one is.
        alone: whether it may be named; otherwise it only explains what others would be named for.
        settled: whether what is known beside the evidence settles it.
        changes: whether it begins during the recording: then alternate stretches of time are its parts.
    """

    cause: Cause | Callable[[Judged], Cause]
    concerned: Sequence[int] | EllipsisType = ...
    read: Callable[[Subject], Subject] | None = None
    undo: Callable[[Subject], Judged] | None = None
    sizes: FloatArray | float = 1.0
    sources: IntArray | EllipsisType = ...
    alone: bool = True
    settled: bool = False
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
    def gain(self) -> float:
        """What it gains per instant [nats]."""
        return (self.judged.log - self.subject.nominal.log) / len(self.subject.samples)

    @property
    def name(self) -> tuple[str, tuple[str, ...]]:
        """The cause's kind and places."""
        return self.cause.kind, self.cause.places

    def shares_joints(self, others: Sequence[Tried]) -> bool:
        """Whether it is about a joint that another is about."""
        return not set(self.cause.places).isdisjoint(place for other in others for place in other.cause.places)

    @property
    def believed(self) -> bool:
        """Whether it repeats and explains no channel worse, or is settled."""
        if self.candidate.settled:
            return True
        better = self.better[self.candidate.concerned]
        return -float(np.sum(better, where=better < 0.0)) <= LEAST_SIGMA * self.gain and self.repeats

    @property
    def better(self) -> FloatArray:
        """By how much it explains each channel better, per instant [nats] ``(C,)``."""
        return np.asarray(np.log(self.subject.nominal.sigmas[self.candidate.sources] / self.judged.sigmas))

    @cached_property
    def repeats(self) -> bool:
        """Whether every part of the recording asks for it, in sizes of one sign."""
        return all(self._repeats(part) for part in self.subject.parts(alternating=self.candidate.changes))

    def _repeats(self, part: Subject) -> bool:
        judged = self.candidate.judged(part)
        off = np.abs(judged.estimates - self.judged.estimates)
        # What noise and friction have in common makes sizes less sure than their deviations say: signs have to agree.
        allowed = np.maximum(np.abs(self.judged.estimates), STDS_OF_95 * judged.deviations)
        return judged.log > part.nominal.log and bool(np.all(off <= allowed))


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """What is decided of candidates.

    Attributes:
        finding: what is wrong; None if nothing is.
        doubted: causes that are probable, but not believed, the most probable first.
        count: of the causes that were tried.
        sigmas: ``(C,)`` of what is left with the finding undone, in standard deviations of the measured channels.
        level: what may only be remarked on, if it is probable.
    """

    finding: Finding | None
    doubted: Sequence[Tried]
    count: int
    sigmas: FloatArray
    level: Cause | None


def decide(tried: Iterable[Tried], count: int, nominal: Evidence) -> Decision:
    """What is wrong: the most probable cause that repeats, or what is settled, with its rivals.

    It is sure unless several other places explain as much. Of a joint that a cause which does not repeat is about,
    nothing else is believed either: it may be explained by the same as that.

    Args:
        tried: the candidates that are worth judging.
        count: how many they are chosen from.
        nominal: the evidence that nothing is wrong.
    """
    ordered = sorted(tried, key=lambda one: -one.gain)
    known = {one: probabilities([one.gain], count)[0] > PROBABLE for one in ordered}
    probable = [one for one in ordered if known[one] and one.candidate.alone]
    doubted = _doubted(probable)
    beside = [one for one in ordered if not one.candidate.alone or not one.shares_joints(doubted)]
    likely = _most_probable(beside, count)
    causes = [one for one in likely if one in probable][:1] + [one for one in ordered if one.candidate.settled]
    # One cause for all joints before one for each.
    best = max(causes, key=lambda one: len(one.cause.places), default=None)
    level = next((one.cause for one in ordered if known[one] and one.cause.settings and not one.candidate.alone), None)
    if best is None:
        return Decision(finding=None, doubted=doubted, count=count, sigmas=nominal.sigmas, level=level)
    if best not in likely:  # what is settled asks for no evidence: whatever has some is its rival
        likely = [*{one.name: one for one in reversed(probable)}.values()]
    rivals = [one for one in likely if one.name != best.name]
    elsewhere = {one.cause.places for one in rivals if one.believed} - {best.cause.places}
    sure = best.candidate.settled or len(elsewhere) <= 1
    finding = Finding(cause=best.cause, sure=sure, rivals=tuple(one.cause for one in rivals) if sure else ())
    return Decision(finding=finding, doubted=(), count=count, sigmas=best.judged.sigmas, level=level)


def contradicted(doubted: Iterable[Tried], count: int) -> tuple[Finding, ...]:
    """That something is wrong, if a cause that repeats is probable by the joints alone whose efforts count on this
    robot, though it explains others worse, or may be explained by one that does not repeat: whatever it is, that the
    recording is right does not explain these.

    Args:
        doubted: causes that are not believed, and such as are hidden by these.
        count: how many they are chosen from.
    """
    for one in doubted:
        counts = (one.better > 0.0) & one.subject.counts
        told = probabilities([float(np.sum(one.better[counts]))], count)[0] > PROBABLE
        if told and one.repeats:
            names = [one.subject.names[channel] for channel in np.flatnonzero(counts)]
            return (Finding(cause=Cause.of("unexplained", names, nearest=one.cause.sentence)),)
    return ()


def _doubted(probable: Sequence[Tried]) -> list[Tried]:
    """The causes that are not believed, or are about the same joints as a more probable one of these, of those that are
    more probable than the first one that is believed."""
    doubted: list[Tried] = []
    for one in probable:
        if one.believed and not one.shares_joints(doubted):
            break
        doubted.append(one)
    return doubted


def _most_probable(tried: Sequence[Tried], count: int) -> list[Tried]:
    """The fewest causes, the best of each name, that are together probable among ``count``, the most probable first;
    none if it may be that nothing is wrong."""
    ordered = [*{one.name: one for one in sorted(tried, key=lambda one: one.gain)}.values()]
    probability = probabilities([one.gain for one in ordered], count)
    order = np.argsort(-probability[:-1])
    fewest = order[: 1 + int(np.searchsorted(np.cumsum(probability[order]), PROBABLE))]
    return [ordered[place] for place in fewest] if probability[-1] < 1.0 - PROBABLE else []


def probabilities(gains: Sequence[float], count: int) -> FloatArray:
    """Probabilities ``(k + 1,)`` of causes, and as the last one of none, at first as probable as all of them together.

    Args:
        gains: of log evidence per instant ``(k,)``.
        count: of the causes that were tried.
    """
    return shares(-2.0 * np.append(FEWEST * np.array(gains), np.log(count)))
