"""Candidates for what is wrong with a recording, the evidence of each, and the rules for naming one.

A candidate undoes a possible fault of a recording. It is evaluated by how much more probable the recording becomes, and
named if that repeats: in every recording, or in both halves of a single one.
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
"""Least probability of a named cause. A recording counts as many independent samples as the shortest one checked."""
LARGEST_MASS_FACTOR = 4.0
"""Largest plausible factor between the masses of a URDF and the true ones: a larger gain is a unit."""
TILT = np.radians(25.0)
"""Largest plausible tilt of a base, and error of a joint's zero [rad]."""
STEP = 1e-4
"""Step of derivatives by positions [rad, m]."""
ROUNDS = 3
"""Rounds of a fit that is relinearised at its result."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CandidateFit:
    """Evaluation of a recording with a candidate undone.

    Attributes:
        log: log evidence of the measured numbers.
        sigmas: ``(C,)`` of the residuals, in standard deviations of the measured channels.
        estimates, deviations: ``(k,)`` sizes that were estimated with it, and their standard deviations.
    """

    log: float
    sigmas: FloatArray
    estimates: FloatArray = field(default_factory=lambda: np.zeros(0))
    deviations: FloatArray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of_corrected(
        mended: Subject, units: FloatArray, found: Evidence | None = None, **estimated: FloatArray
    ) -> CandidateFit:
        """Evaluate a corrected subject.

        Args:
            of_corrected: with the candidate undone.
            units: ``(C,)`` one standard deviation of the measured numbers, in its efforts.
            found: its evidence in these units, by default without further unknowns.
            **estimated: see :class:`CandidateFit`.
        """
        found = mended.in_units(units).nominal if found is None else found
        return CandidateFit(log=found.log, sigmas=found.sigmas, **estimated)


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """A possible fault.

    Attributes:
        cause: its cause, or a function of the estimates that makes it.
        concerned: the channels that it changes, all by default.
        read: reads a subject with the candidate undone; also ranks the candidates of a row.
        undo: evaluates a subject with the candidate undone, where another reading is not enough.
        sizes: ``(C,)`` factors on efforts then.
        sources: ``(C,)`` the measured channel of each evaluated one.
        alone: True if it may be named; otherwise it only explains what others would be named for.
        settled: True if other knowledge than the evidence settles it.
        changes: True if it begins during the recording: then alternate stretches of time are its parts.
    """

    cause: Cause | Callable[[CandidateFit], Cause]
    concerned: Sequence[int] | EllipsisType = ...
    read: Callable[[Subject], Subject] | None = None
    undo: Callable[[Subject], CandidateFit] | None = None
    sizes: FloatArray | float = 1.0
    sources: IntArray | EllipsisType = ...
    alone: bool = True
    settled: bool = False
    changes: bool = False

    def resemblance(self, few: Subject) -> float:
        """Resemblance of the reading and the prediction, see :attr:`Subject.resemblance`."""
        return np.inf if self.read is None else self.read(few).resemblance

    def judged(self, subject: Subject) -> CandidateFit:
        """Evaluate a subject with the candidate undone."""
        if self.undo is not None:
            return self.undo(subject)
        read = subject if self.read is None else self.read(subject)
        return CandidateFit.of_corrected(read, self.sizes * subject.measured_std[self.sources])


@dataclass(frozen=True, eq=False)
class CandidateTest:
    """A candidate that was evaluated on a subject."""

    candidate: Candidate
    subject: Subject
    judged: CandidateFit
    cause: Cause

    @staticmethod
    def of(candidate: Candidate, subject: Subject) -> CandidateTest:
        """Evaluate a candidate."""
        judged = candidate.judged(subject)
        cause = candidate.cause
        return CandidateTest(candidate, subject, judged, cause if isinstance(cause, Cause) else cause(judged))

    @property
    def gain(self) -> float:
        """Gain of log evidence per sample [nats]."""
        return (self.judged.log - self.subject.nominal.log) / len(self.subject.samples)

    @property
    def name(self) -> tuple[str, tuple[str, ...]]:
        """Kind and places of the cause."""
        return self.cause.kind, self.cause.places

    def shares_joints(self, others: Sequence[CandidateTest]) -> bool:
        """True if it concerns a joint that another one concerns."""
        return not set(self.cause.places).isdisjoint(place for other in others for place in other.cause.places)

    @property
    def believed(self) -> bool:
        """True if it repeats and explains no channel worse, or is settled."""
        if self.candidate.settled:
            return True
        better = self.better[self.candidate.concerned]
        return -float(np.sum(better, where=better < 0.0)) <= LEAST_SIGMA * self.gain and self.repeats

    @property
    def better(self) -> FloatArray:
        """Gain of each channel per sample [nats] ``(C,)``."""
        return np.asarray(np.log(self.subject.nominal.sigmas[self.candidate.sources] / self.judged.sigmas))

    @cached_property
    def repeats(self) -> bool:
        """True if every part of the recording supports it, with sizes of one sign."""
        return all(self._repeats(part) for part in self.subject.parts(alternating=self.candidate.changes))

    def _repeats(self, part: Subject) -> bool:
        judged = self.candidate.judged(part)
        differences = np.abs(judged.estimates - self.judged.estimates)
        # Noise that correlates with friction makes sizes less certain than their deviations: signs have to agree.
        allowed = np.maximum(np.abs(self.judged.estimates), STDS_OF_95 * judged.deviations)
        return judged.log > part.nominal.log and bool(np.all(differences <= allowed))


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """Decision among candidates.

    Attributes:
        finding: what is wrong; None if nothing is.
        doubted: causes that are probable, but not believed, the most probable first.
        count: number of causes that were tried.
        sigmas: ``(C,)`` of the residuals with the finding undone, in standard deviations of the measured channels.
        level: cause that is only remarked on, if it is probable.
    """

    finding: Finding | None
    doubted: Sequence[CandidateTest]
    count: int
    sigmas: FloatArray
    level: Cause | None


def decide(tried: Iterable[CandidateTest], count: int, nominal: Evidence) -> Decision:
    """Choose the most probable cause that repeats, or one that is settled, with its rivals.

    It is certain unless several other places explain as much. If a probable cause does not repeat, nothing else is
    believed of its joints either: the same fault may explain it.

    Args:
        tried: the candidates that are worth evaluating.
        count: number of those that they are chosen from.
        nominal: the evidence that nothing is wrong.
    """
    ordered = sorted(tried, key=lambda one: -one.gain)
    above = {one: probabilities([one.gain], count)[0] > PROBABLE for one in ordered}
    probable = [one for one in ordered if above[one] and one.candidate.alone]
    doubted = _doubted(probable)
    unshared = [one for one in ordered if not one.candidate.alone or not one.shares_joints(doubted)]
    likely = _most_probable(unshared, count)
    causes = [one for one in likely if one in probable][:1] + [one for one in ordered if one.candidate.settled]
    # A cause common to all joints precedes one for each.
    best = max(causes, key=lambda one: len(one.cause.places), default=None)
    level = next((one.cause for one in ordered if above[one] and one.cause.settings and not one.candidate.alone), None)
    if best is None:
        return Decision(finding=None, doubted=doubted, count=count, sigmas=nominal.sigmas, level=level)
    if best not in likely:  # a settled cause needs no evidence: any that has some is its rival
        likely = [*{one.name: one for one in reversed(probable)}.values()]
    rivals = [one for one in likely if one.name != best.name]
    elsewhere = {one.cause.places for one in rivals if one.believed} - {best.cause.places}
    sure = best.candidate.settled or len(elsewhere) <= 1
    finding = Finding(cause=best.cause, sure=sure, rivals=tuple(one.cause for one in rivals) if sure else ())
    return Decision(finding=finding, doubted=(), count=count, sigmas=best.judged.sigmas, level=level)


def contradicted(doubted: Iterable[CandidateTest], count: int) -> tuple[Finding, ...]:
    """Report an unknown fault if a repeating cause is probable on the joints whose efforts count on this robot. It may
    explain other joints worse, or be hidden by a cause that does not repeat. Whatever it is, a correct recording does
    not explain these efforts.

    Args:
        doubted: causes that are not believed, and those hidden by them.
        count: number of causes that they are chosen from.
    """
    for one in doubted:
        counts = (one.better > 0.0) & one.subject.counts
        is_probable = probabilities([float(np.sum(one.better[counts]))], count)[0] > PROBABLE
        if is_probable and one.repeats:
            names = [one.subject.names[channel] for channel in np.flatnonzero(counts)]
            return (Finding(cause=Cause.of("unexplained", names, nearest=one.cause.sentence)),)
    return ()


def _doubted(probable: Sequence[CandidateTest]) -> list[CandidateTest]:
    """Causes more probable than the first believed one: not believed, or on joints of a more probable doubted one."""
    doubted: list[CandidateTest] = []
    for one in probable:
        if one.believed and not one.shares_joints(doubted):
            break
        doubted.append(one)
    return doubted


def _most_probable(tried: Sequence[CandidateTest], count: int) -> list[CandidateTest]:
    """The fewest causes, the best of each name, that are together probable among ``count``, the most probable first;
    none if possibly nothing is wrong."""
    ordered = [*{one.name: one for one in sorted(tried, key=lambda one: one.gain)}.values()]
    probability = probabilities([one.gain for one in ordered], count)
    order = np.argsort(-probability[:-1])
    fewest = order[: 1 + int(np.searchsorted(np.cumsum(probability[order]), PROBABLE))]
    return [ordered[place] for place in fewest] if probability[-1] < 1.0 - PROBABLE else []


def probabilities(gains: Sequence[float], count: int) -> FloatArray:
    """Probabilities ``(k + 1,)`` of causes and, last, of none, whose prior probability is that of all causes together.

    Args:
        gains: of log evidence per sample ``(k,)``.
        count: number of causes that were tried.
    """
    return shares(-2.0 * np.append(FEWEST * np.array(gains), np.log(count)))
