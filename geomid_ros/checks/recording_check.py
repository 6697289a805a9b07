"""Check of a recording as a whole: collects samples as they come, and reports what is wrong with the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.candidates import CandidateTest, FaultDecision, contradicted, decide
from geomid_ros.checks.causes import MODEL, NOT_CHECKED, Cause, RecordingFault, as_faults
from geomid_ros.checks.changes import changes, lags
from geomid_ros.checks.definite_faults import (
    frozen_position,
    held_efforts,
    impossible_description,
    noisy_accelerations,
    wrong_gains,
)
from geomid_ros.checks.effort_data import EffortData, is_changing, is_measured
from geomid_ros.checks.evidence import LARGEST_RESIDUAL, LEAST_SIGMA, MOST
from geomid_ros.checks.moving_base import carried_weight, gyroscope, on_all_feet, reversed_efforts, unnamed_feet
from geomid_ros.checks.sample_reservoir import FEWEST, KeptSamples, RecentMotion, SampleReservoir
from geomid_ros.checks.transforms import transforms
from geomid_ros.checks.unexplained import badly_explained, hint, rms
from geomid_ros.checks.wrench_sensors import WrenchSensorCheck, can_be_checked
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REST_SPEED, SIGN, SMOOTH_SIGN, Samples
from geomid_ros.signals.moving_base import in_order
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Excerpt of recordings: ``kept``, a few samples of all of them; ``recent_motion``, the last samples in motion,
    None without any; ``recent_stance``, such a stretch with all feet on the ground; ``continuous``: True if no
    positions jump."""

    kept: KeptSamples
    recent_motion: Samples | None
    recent_stance: Samples | None
    continuous: bool = True


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Findings on what seems wrong with a recording, and remarks on one that may be right, as sentences."""

    findings: tuple[RecordingFault, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class CheckTask:
    """Inputs of the check of a recording.

    Attributes:
        model: of the robot.
        gains: ``(joints,)`` factors on the messages' efforts.
        sensors: the names of the wrench sensors in the configuration, by topic.
        controller: with which efforts were computed, if they were.
    """

    model: MeasurementModel
    gains: FloatArray
    sensors: Mapping[str, str]
    controller: PDController | None = None

    def judge(self, excerpt: Excerpt) -> CheckResult:
        """Check an excerpt of a recording."""
        samples, joints = excerpt.kept.samples, self.model.robot.joint_names
        if self.controller and (wrong := wrong_gains(self.controller, samples, joints)):
            return CheckResult(as_faults(wrong))
        if no_external_forces(self.model):
            judged = check_efforts(self.model, excerpt.kept, self.gains, whole=excerpt.continuous)
        else:
            judged = CheckResult(as_faults(self._legs(excerpt)))
        if judged.findings:  # a wrong motion makes the wrench sensors look wrong, too
            return judged
        return replace(judged, findings=tuple(self._wrenches(excerpt)))

    def _legs(self, excerpt: Excerpt) -> list[Cause]:
        legs, samples = self.model.legs, excerpt.kept.samples
        if legs is None:
            return []
        robot = self.model.robot
        causes = reversed_efforts(legs, samples, robot.joint_names, self.gains)
        causes = causes or [*carried_weight(legs, samples), *unnamed_feet(robot, legs, samples)]
        return causes or ([] if excerpt.recent_stance is None else gyroscope(legs, excerpt.recent_stance))

    def _wrenches(self, excerpt: Excerpt) -> Iterator[RecordingFault]:
        samples, dense = excerpt.kept.samples, excerpt.recent_motion
        for sensor in self.model.mounted:
            if dense is not None and can_be_checked(sensor):
                name = self.sensors.get(sensor.topic, sensor.topic)
                yield from WrenchSensorCheck(self.model, sensor, name, samples, dense).findings()


def no_external_forces(model: MeasurementModel) -> bool:
    """True if links and gravity alone determine the efforts, not the surroundings."""
    external = len(model.sensors) > len(model.mounted)
    return bool(model.layout.efforts) and not model.robot.floating_base and not external


RunCheck: TypeAlias = Callable[[CheckTask, Excerpt], CheckResult]


class RecordingCheck:
    """Keep a few samples of the recording, and check them on request.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, task: CheckTask, run_check: RunCheck = CheckTask.judge) -> None:
        """
        Args:
            task: inputs of the check.
            run_check: does the check; in another process, for example.
        """
        self._task = task
        self._judge = run_check
        self._instants = SampleReservoir()
        self._stretch, self._standing = RecentMotion(), RecentMotion()
        self._judged_at = 0.0
        self.remarks: tuple[str, ...] = ()
        """Remarks on a recording that may be right, once it has been checked."""

    def add(self, samples: Samples) -> None:
        """Add samples, in the order of time of each recording."""
        for part in in_order(samples.with_columns([SIGN, SMOOTH_SIGN])):
            self._instants.add(part)
            self._stretch.add(part)
            if self._task.model.legs is not None:
                self._standing.add(on_all_feet(self._task.model.legs, part))

    def begin_recording(self, bag: str) -> None:
        """Begin another recording, which has to show the same; ``bag`` is its name."""
        self._instants.begin_recording(bag)

    @property
    def due(self) -> bool:
        """True if half of the samples came after the last check: it is done more and more rarely."""
        return len(self._instants) >= FEWEST and self._instants.taken > 2.0 * self._judged_at

    def findings(self, *, continuous: bool = True) -> tuple[RecordingFault, ...]:
        """Return what seems wrong with the recording, without changes during it unless it is ``continuous``: where
        positions jump, another recording begins, perhaps of another robot."""
        kept, self._judged_at = self._instants.kept, self._instants.taken
        if kept is None:
            return ()
        judgement = self._judge(self._task, Excerpt(kept, self._stretch.samples, self._standing.samples, continuous))
        self.remarks = judgement.remarks
        return judgement.findings

    def changes_until(self, later: RecordingCheck) -> tuple[RecordingFault, ...]:
        """Return what seems to have changed until ``later`` recordings of the same robot, in which nothing is wrong."""
        before, after = self._instants.kept, later._instants.kept
        if before is None or after is None:
            return ()
        return self._judge(self._task, Excerpt(before.then(after), None, None)).findings

    @property
    def recorded(self) -> Samples | None:
        """Kept samples; None if there are none."""
        kept = self._instants.kept
        return None if kept is None else kept.samples

    @property
    def unmeasured(self) -> list[str]:
        """Joints whose efforts are missing in more than half of the samples."""
        samples, model = self.recorded, self._task.model
        if samples is None or not model.layout.efforts:
            return []
        return [model.robot.joint_names[joint] for joint in np.flatnonzero(~is_measured(samples))]


def check_efforts(model: MeasurementModel, kept: KeptSamples, gains: FloatArray, *, whole: bool = True) -> CheckResult:
    """Check the efforts of a recording.

    Args:
        model: of the robot.
        kept: a few samples of the recording.
        gains: ``(joints,)`` factors on the messages' efforts.
        whole: True to look for changes during the recording, too.
    """
    subject = EffortData.of(model.robot, kept, gains)
    moves = np.std(kept.samples.velocity, axis=0) > REST_SPEED
    constant = moves & is_measured(kept.samples) & ~is_changing(kept.samples.effort)
    names = [model.robot.joint_names[joint] for joint in np.flatnonzero(constant)]
    findings = as_faults([Cause.of("constant", names)] if names else [])
    if np.count_nonzero(subject.is_moving) < FEWEST:
        moving = np.count_nonzero(np.any(np.abs(kept.samples.velocity) > REST_SPEED, axis=1))
        return CheckResult(findings, (NOT_CHECKED,) if moving >= FEWEST else ())
    judged = _judged(subject, whole)
    return replace(judged, findings=(*findings, *judged.findings))


def _judged(subject: EffortData, continuous: bool) -> CheckResult:
    """Check efforts that change."""
    plain = next(chain(impossible_description(subject), noisy_accelerations(subject), frozen_position(subject)), None)
    if plain is not None:
        return CheckResult(as_faults([plain]))
    remarks: tuple[str, ...] = (MODEL,) if is_model(subject) else ()
    held = as_faults(held_efforts(subject))
    decision = _decided(subject, continuous)
    if decision.finding is None and decision.remarked_cause is not None:
        remarks += (decision.remarked_cause.sentence,)
        subject = subject.under_gravity(np.array(decision.remarked_cause.settings["gravity"]))
        decision = _decided(subject, continuous)
    named = held if decision.finding is None else (*held, decision.finding)
    doubted = decision.unconfirmed
    findings = named or as_faults(_unexplained(subject) or contradicted(doubted, decision.count))
    if not findings and doubted:
        remarks += (f"suspected from a part of the recording, or some joints, alone: {doubted[0].cause.sentence}",)
    return CheckResult(findings, remarks)


def _decided(subject: EffortData, continuous: bool) -> FaultDecision:
    """Decide which cause explains the efforts better than a correct recording."""
    throughout, count = transforms(subject)
    timed = [*(changes(subject) if continuous else ()), *lags(subject)]
    tried = [CandidateTest(candidate, subject) for candidate in (*throughout, *timed)]
    decision = decide(tried, count + len(timed), subject.nominal)
    feels_none = decision.finding is None and subject.of_friction.log_evidence > subject.nominal.log_evidence
    if feels_none or np.all(decision.fit.sigmas > LARGEST_RESIDUAL):
        unrelated = RecordingFault(cause=Cause.of("unrelated", subject.names))
        return replace(decision, finding=unrelated, remarked_cause=None)
    return decision


def _unexplained(subject: EffortData) -> list[Cause]:
    """Joints whose efforts neither links and friction nor curves of their motion explain, for any reason."""
    curved = subject.baseline_fit.nominal.sigmas > LARGEST_RESIDUAL
    residual = np.where(curved, subject.measured - subject.explained(subject.nominal), np.nan)
    channels = [*zip(subject.names, subject.units, strict=True)]
    return badly_explained(
        channels, rms(residual), subject.measured_std, partial(hint, subject), allowed=LARGEST_RESIDUAL
    )


def is_model(subject: EffortData) -> bool:
    """True if efforts are the prediction of the URDF, without friction or errors."""
    residual_rms = np.sqrt(np.mean((subject.measured - subject.predicted) ** 2, axis=0))
    return bool(np.all(residual_rms < MOST * LEAST_SIGMA * subject.measured_std))
