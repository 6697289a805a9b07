"""The check of a recording as a whole: takes samples as they come, and says what the recording seems to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.base import carried_weight, unnamed_feet
from geomid_ros.checks.candidates import Decision, Tried, contradicted, decide
from geomid_ros.checks.causes import MODEL, Cause, Finding
from geomid_ros.checks.changes import changes, lags
from geomid_ros.checks.evidence import FOLLOWS, HALF, LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST, Instants, Kept, Stretch
from geomid_ros.checks.obvious import frozen_position, held_efforts, impossible_description, wrong_gains
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.transforms import transforms
from geomid_ros.checks.unexplained import Residuals, hint
from geomid_ros.checks.wrenches import WrenchSensorCheck, can_be_judged
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.controller import Controller
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import SIGN, STILL, Samples
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Excerpt:
    """What is kept of recordings: a few instants of all of them, and a ``stretch``, the last instants at which
    something moved; None if there were none."""

    kept: Kept
    stretch: Samples | None


@dataclass(frozen=True, eq=False)
class Judgement:
    """What seems to be wrong with a recording, and what to know of one that may be right, in sentences."""

    findings: tuple[Finding, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class JudgementTask:
    """What a recording is judged by.

    Attributes:
        model: of the robot.
        gains: ``(joints,)`` factors that the messages' efforts are multiplied by.
        sensors: the names of the wrench sensors in the configuration, by topic.
        controller: that efforts were computed with, if they were.
    """

    model: MeasurementModel
    gains: FloatArray
    sensors: Mapping[str, str]
    controller: Controller | None = None

    def judge(self, excerpt: Excerpt) -> Judgement:
        """What a recording seems to be, by an excerpt of it."""
        findings: list[Finding] = []
        remarks: list[str] = []
        names = self.model.robot.joint_names
        if self.controller and (other := wrong_gains(self.controller, excerpt.kept.samples, names)):
            findings = [other]
        elif efforts_alone(self.model):
            check = EffortCheck(self.model, excerpt.kept, self.gains)
            findings, remarks = check.findings(), check.remarks
        elif self.model.legs is not None:
            samples = excerpt.kept.samples
            both = carried_weight(self.model.legs, samples), unnamed_feet(self.model.robot, self.model.legs, samples)
            findings = [found for found in both if found is not None]
        if not findings:  # a motion that is not the robot's would be the sensors' fault, too
            wrong = (self._wrench(sensor, excerpt) for sensor in self.model.mounted)
            findings = [finding for finding in wrong if finding is not None]
        return Judgement(tuple(findings), tuple(remarks))

    def _wrench(self, sensor: WrenchSensor, excerpt: Excerpt) -> Finding | None:
        if excerpt.stretch is None or not can_be_judged(sensor):
            return None
        name = self.sensors.get(sensor.topic, sensor.topic)
        return WrenchSensorCheck(self.model, sensor, name, excerpt.kept.samples, excerpt.stretch).finding()


def efforts_alone(model: MeasurementModel) -> bool:
    """Whether links and gravity alone decide on the efforts: not what the surroundings do to the robot."""
    external = len(model.sensors) > len(model.mounted)
    return bool(model.layout.efforts) and not model.robot.floating_base and not external


Judge: TypeAlias = Callable[[JudgementTask, Excerpt], Judgement]


class RecordingCheck:
    """Keeps a few instants of what was recorded, and judges them when asked.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, task: JudgementTask, judge: Judge = JudgementTask.judge) -> None:
        """
        Args:
            task: what is judged by.
            judge: judges; in another process, for example.
        """
        self._task = task
        self._judge = judge
        self._instants = Instants()
        self._stretch = Stretch()
        self._judged_at = 0.0
        self.remarks: tuple[str, ...] = ()
        """What to know of a recording that may be right, once it has been judged."""

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time of each recording."""
        needed = samples.with_columns([SIGN])
        self._instants.add(needed)
        self._stretch.add(needed)

    def begin_recording(self) -> None:
        """The samples to come are of another recording, which has to show the same."""
        self._instants.begin_recording()

    @property
    def due(self) -> bool:
        """Whether half of what is known came after it was judged last: seldom, as time goes on."""
        return len(self._instants) >= FEWEST and self._instants.taken > 2.0 * self._judged_at

    def findings(self) -> tuple[Finding, ...]:
        """What seems to be wrong with the recording as a whole."""
        kept, self._judged_at = self._instants.kept, self._instants.taken
        if kept is None:
            return ()
        judgement = self._judge(self._task, Excerpt(kept, self._stretch.samples))
        self.remarks = judgement.remarks
        return judgement.findings

    @property
    def recorded(self) -> Samples | None:
        """The instants that are kept; None if there are none."""
        kept = self._instants.kept
        return None if kept is None else kept.samples

    @property
    def unmeasured(self) -> list[str]:
        """The joints whose efforts are missing at half of the instants or more: empty, not finite or all zero."""
        samples, model = self.recorded, self._task.model
        if samples is None or not model.layout.efforts:
            return []
        shares = np.mean(np.isfinite(samples.effort), axis=0)
        return [name for name, share in zip(model.robot.joint_names, shares, strict=True) if share < HALF]


class EffortCheck:
    """Compares what the efforts of a recording may be."""

    def __init__(self, model: MeasurementModel, kept: Kept, gains: FloatArray) -> None:
        """
        Args:
            model: of the robot.
            kept: a few instants of the recording.
            gains: ``(joints,)`` factors that the messages' efforts were multiplied by.
        """
        self._subject = Subject.of(model.robot, kept, gains)
        moves = np.std(kept.samples.velocity, axis=0) > STILL
        constant = moves & (np.mean(np.isfinite(kept.samples.effort), axis=0) >= HALF)
        constant[self._subject.joints] = False
        self._constant = [model.robot.joint_names[joint] for joint in np.flatnonzero(constant)]
        self._enough = np.count_nonzero(self._subject.is_moving) >= FEWEST
        self.remarks: list[str] = []
        """What to know of efforts that may be right, once they have been judged."""

    def findings(self) -> list[Finding]:
        """What is wrong; empty if nothing is, or nothing can be told."""
        found = [Finding(cause=Cause.of("constant", self._constant))] if self._constant else []
        return [*found, *self._judged()] if self._enough else found

    def _judged(self) -> list[Finding]:
        subject = self._subject
        plain = impossible_description(subject) or frozen_position(subject)
        if plain is not None:
            return [Finding(cause=plain)]
        self.remarks = [MODEL] if is_model(subject) else []
        held = [Finding(cause=cause) for cause in held_efforts(subject)]
        decision = self._decided(subject)
        if decision.finding is None and decision.level is not None:
            self.remarks.append(decision.level.sentence)
            subject = subject.under(np.array(decision.level.settings["gravity"]))
            decision = self._decided(subject)
        named = held if decision.finding is None else [*held, decision.finding]
        return named or _unexplained(subject) or self._doubts(decision)

    def _decided(self, subject: Subject) -> Decision:
        """What explains efforts better than that they are as they should be."""
        throughout, count = transforms(subject)
        others = [*changes(subject), *lags(subject)]
        tried = [Tried.of(candidate, subject) for candidate in (*throughout, *others)]
        decision = decide(tried, count + len(others), subject.nominal)
        if np.all(decision.sigmas > FOLLOWS):
            return replace(decision, finding=Finding(cause=Cause.of("unrelated", subject.names)), level=None)
        return decision

    def _doubts(self, decision: Decision) -> list[Finding]:
        """What is wrong, whatever it is; else what may be is remarked on."""
        found = contradicted(decision.doubted, decision.count)
        if found is None and decision.doubted:
            said = decision.doubted[0].cause.sentence
            self.remarks.append(f"in a part of the recording, or at some joints, only: {said}")
        return [] if found is None else [found]


def _unexplained(subject: Subject) -> list[Finding]:
    """The joints whose efforts no links and no friction explain, and curves of their motion hardly do, whatever the
    reason."""
    curved = subject.flexible.nominal.sigmas > FOLLOWS
    residuals = Residuals(
        names=subject.names,
        units=subject.units,
        efforts=subject.measured,
        residuals=np.where(curved, subject.measured - subject.explained(subject.nominal), np.nan),
        before=np.full(len(subject.joints), np.inf),
        hint=partial(hint, subject),
    )
    found = residuals.finding(subject.spread, FOLLOWS)
    return [] if found is None else [found]


def is_model(subject: Subject) -> bool:
    """Whether efforts are what the URDF predicts: without friction, without any error."""
    left = np.sqrt(np.mean((subject.measured - subject.predicted) ** 2, axis=0))
    return bool(np.all(left < HALF * LEAST_SIGMA * subject.spread))
