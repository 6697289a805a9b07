"""Candidates for what is wrong with a recording, the evidence of each, and the rules for naming one.

A candidate undoes a possible fault of a recording. It is evaluated by how much more probable the recording becomes, and
named if that repeats: in every recording, or in both halves of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import EllipsisType

import numpy as np

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence
from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.inference.probability import posterior_probabilities
from geomid_ros.types import FloatArray, IntArray

PROBABLE = 0.9
"""Least probability of a named cause. A recording counts as many independent samples as the shortest one checked."""
MASS_FACTOR = 4.0
"""Largest plausible factor between the masses of a URDF and the true ones: a larger gain is a unit."""
TILT = np.radians(25.0)
"""Largest plausible tilt of a base, and error of a joint's zero [rad]."""
ROUNDS = 3
"""Rounds of a fit that is relinearised at its result."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultCandidate:
    """A possible fault.

    Attributes:
        cause: its cause, or a function that makes it of the evidence with the candidate undone.
        corrected: reads a subject with the candidate undone; also ranks the candidates of a row.
        fit_corrected: evaluates a subject with the candidate undone, where another reading is not enough; in units of
            the measured numbers, see :meth:`EffortData.in_units`.
        sizes: ``(C,)`` sizes of the factors on efforts that undo it, one by default.
        sources: ``(C,)`` the measured channel of each evaluated one.
        may_be_named: True if it may be named; otherwise it only explains what others would be named for.
        needs_no_evidence: True if other knowledge than the evidence settles it.
        begins_during_recording: True if it begins during the recording: then alternate stretches of time are its parts.
    """

    cause: Cause | Callable[[Evidence], Cause]
    corrected: Callable[[EffortData], EffortData] | None = None
    fit_corrected: Callable[[EffortData], Evidence] | None = None
    sizes: FloatArray | None = None
    sources: IntArray | EllipsisType = ...
    may_be_named: bool = True
    needs_no_evidence: bool = False
    begins_during_recording: bool = False

    def resemblance(self, few: EffortData) -> float:
        """Resemblance of the reading and the prediction, see :attr:`EffortData.resemblance`."""
        return np.inf if self.corrected is None else self.corrected(few).resemblance

    def evaluate(self, subject: EffortData) -> Evidence:
        """Evaluate a subject with the candidate undone."""
        if self.fit_corrected is not None:
            return self.fit_corrected(subject)
        read = subject if self.corrected is None else self.corrected(subject)
        units = subject.measured_std[self.sources]
        return read.in_units(units if self.sizes is None else self.sizes * units).nominal


@dataclass(frozen=True, eq=False)
class CandidateTest:
    """A candidate that is evaluated on a subject."""

    candidate: FaultCandidate
    subject: EffortData

    @cached_property
    def fit(self) -> Evidence:
        """Evidence with the candidate undone."""
        return self.candidate.evaluate(self.subject)

    @cached_property
    def cause(self) -> Cause:
        """Its cause."""
        cause = self.candidate.cause
        return cause if isinstance(cause, Cause) else cause(self.fit)

    @property
    def gain(self) -> float:
        """Gain of log evidence per sample [nats]."""
        return (self.fit.log_evidence - self.subject.nominal.log_evidence) / len(self.subject.samples)

    @property
    def name(self) -> tuple[str, tuple[str, ...]]:
        """Kind and places of the cause."""
        return self.cause.kind, self.cause.places

    def shares_joints(self, others: Sequence[CandidateTest]) -> bool:
        """True if it concerns a joint that another one concerns."""
        return not set(self.cause.places).isdisjoint(place for other in others for place in other.cause.places)

    @property
    def is_accepted(self) -> bool:
        """True if it repeats, leaves plausible links, and no channels contradict it together with those of larger
        efforts; or if it needs no evidence. Links of a recording in which something changes need not be plausible."""
        if self.candidate.needs_no_evidence:
            return True
        by_size = np.cumsum(self.channel_gains[np.argsort(-self.subject.relative_std[self.candidate.sources])])
        plausible = self.candidate.begins_during_recording or self.has_plausible_links
        return not is_probable(-float(np.min(by_size)), 1) and plausible and self.repeats

    @property
    def has_plausible_links(self) -> bool:
        """True if links of plausible size explain the efforts with the candidate undone."""
        size = float(np.median(self.subject.sizes_of_links(self.fit)))
        return 1.0 / MASS_FACTOR <= size <= MASS_FACTOR

    @property
    def channel_gains(self) -> FloatArray:
        """Gain of each channel per sample [nats] ``(C,)``."""
        return np.asarray(np.log(self.subject.nominal.sigmas[self.candidate.sources] / self.fit.sigmas))

    @cached_property
    def repeats(self) -> bool:
        """True if every part of the recording supports it, with sizes of one sign."""
        parts = self.subject.alternating if self.candidate.begins_during_recording else self.subject.halves
        return all(map(self._repeats, parts))

    def _repeats(self, part: EffortData) -> bool:
        judged = self.candidate.evaluate(part)
        differences = np.abs(judged.estimates - self.fit.estimates)
        # Noise that correlates with friction makes sizes less certain than their deviations: signs have to agree.
        allowed = np.maximum(np.abs(self.fit.estimates), STDS_OF_95 * judged.estimate_deviations)
        return judged.log_evidence > part.nominal.log_evidence and bool(np.all(differences <= allowed))


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultDecision:
    """Decision among candidates.

    Attributes:
        count: number of causes that were tried.
        fit: evidence with the finding undone.
        remarked_cause: cause that is only remarked on, if it is probable.
        finding: what is wrong; None if nothing is.
        unconfirmed: causes that are probable, but not believed, the most probable first.
    """

    count: int
    fit: Evidence
    remarked_cause: Cause | None
    finding: RecordingFault | None = None
    unconfirmed: Sequence[CandidateTest] = ()


def decide(tried: Iterable[CandidateTest], count: int, nominal: Evidence) -> FaultDecision:
    """Choose the most probable cause that repeats, or one that is settled, with its rivals.

    It is certain unless several other places explain as much. If a probable cause does not repeat, nothing else is
    believed of its joints either: the same fault may explain it.

    Args:
        tried: the candidates that are worth evaluating.
        count: number of those that they are chosen from.
        nominal: the evidence that nothing is wrong.
    """
    ordered = sorted(tried, key=lambda one: -one.gain)
    above = [one for one in ordered if is_probable(one.gain, count)]
    probable = [one for one in above if one.candidate.may_be_named]
    doubted = _doubted(probable)
    unshared = [one for one in ordered if not one.candidate.may_be_named or not one.shares_joints(doubted)]
    likely = _most_probable(unshared, count)
    causes = [one for one in likely if one in probable][:1]
    settled = [one for one in ordered if one.candidate.needs_no_evidence]
    # Evidence that another cause is more probable overrules a settled one, unless links remain implausible.
    contrary = max((one.gain for one in causes), default=-np.inf)
    causes += [one for one in settled if not is_probable(contrary - one.gain, count)]
    # A cause common to all joints precedes one for each.
    best = max(causes, key=lambda one: len(one.cause.places), default=None)
    level = next((one.cause for one in above if one.cause.settings and not one.candidate.may_be_named), None)
    if best is None:
        return FaultDecision(count=count, fit=nominal, remarked_cause=level, unconfirmed=doubted)
    if best not in likely:  # a settled cause needs no evidence: any that has some is its rival
        likely = [*{one.name: one for one in reversed(probable)}.values()]
    rivals = [one for one in likely if one.name != best.name and (not settled or one.has_plausible_links)]
    elsewhere = {one.cause.places for one in rivals if one.is_accepted} - {best.cause.places}
    sure = best.candidate.needs_no_evidence or len(elsewhere) <= 1
    finding = RecordingFault(cause=best.cause, sure=sure, rivals=tuple(one.cause for one in rivals) if sure else ())
    return FaultDecision(count=count, fit=best.fit, remarked_cause=level, finding=finding)


def contradicted(doubted: Iterable[CandidateTest], count: int) -> list[Cause]:
    """Report an unknown fault if a repeating cause is probable on the joints whose efforts count on this robot. It may
    explain other joints worse, or be hidden by a cause that does not repeat. Whatever it is, a correct recording does
    not explain these efforts.

    Args:
        doubted: causes that are not believed, and those hidden by them.
        count: number of causes that they are chosen from.
    """
    for one in doubted:
        counts = (one.channel_gains > 0.0) & (one.subject.relative_std > LEAST_SIGMA)
        if is_probable(float(np.sum(one.channel_gains[counts])), count) and one.repeats:
            names = [one.subject.names[channel] for channel in np.flatnonzero(counts)]
            return [Cause.of("unexplained", names, nearest=one.cause.sentence)]
    return []


def _doubted(probable: Sequence[CandidateTest]) -> list[CandidateTest]:
    """Causes more probable than the first believed one: not believed, or on joints of a more probable doubted one."""
    doubted: list[CandidateTest] = []
    for one in probable:
        if one.is_accepted and not one.shares_joints(doubted):
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


def is_probable(gain: float, count: int) -> bool:
    """True if one of ``count`` causes is probable, with a gain of log evidence per sample."""
    return bool(probabilities([gain], count)[0] > PROBABLE)


def probabilities(gains: Sequence[float], count: int) -> FloatArray:
    """Probabilities ``(k + 1,)`` of causes and, last, of none, whose prior probability is that of all causes together.

    Args:
        gains: of log evidence per sample ``(k,)``.
        count: number of causes that were tried.
    """
    return posterior_probabilities(-2.0 * np.append(FEWEST * np.array(gains), np.log(count)))
