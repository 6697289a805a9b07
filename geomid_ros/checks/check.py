"""The check of a recording as a whole: takes samples as they come, and says what the recording seems to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.causes import Finding
from geomid_ros.checks.efforts import MEASURED, EffortCheck
from geomid_ros.checks.instants import FEWEST, Instants, Kept, Stretch
from geomid_ros.checks.wrenches import WrenchSensorCheck, can_be_judged
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.moving import SIGN
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
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
    """

    model: MeasurementModel
    gains: FloatArray
    sensors: Mapping[str, str]

    def judge(self, excerpt: Excerpt) -> Judgement:
        """What a recording seems to be, by an excerpt of it."""
        findings: list[Finding] = []
        remarks: list[str] = []
        if efforts_alone(self.model):
            check = EffortCheck(self.model, excerpt.kept, self.gains)
            findings, remarks = check.findings(), check.remarks
        wrenches = filter(None, (self._wrench(sensor, excerpt) for sensor in self.model.mounted))
        return Judgement((*findings, *wrenches), tuple(remarks))

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
        return [name for name, share in zip(model.robot.joint_names, shares, strict=True) if share < MEASURED]
