"""Whether the efforts of a recording are those of this robot: candidates for what is wrong are judged and compared."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.candidates import FOLLOWS, Tried, decide
from geomid_ros.checks.causes import MODEL, Cause, Finding
from geomid_ros.checks.changes import changes, lags
from geomid_ros.checks.gates import frozen_position, held_efforts, impossible_description, is_model
from geomid_ros.checks.instants import FEWEST, Kept
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.transforms import candidates
from geomid_ros.checks.unexplained import Residuals
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.signals.saturation import STANDING
from geomid_ros.types import BoolArray, FloatArray, IntArray

MEASURED = 0.5
"""The least share of instants at which the effort of a joint that is judged is measured."""


class EffortCheck:
    """Compares what the efforts of a recording may be."""

    def __init__(
        self,
        model: MeasurementModel,
        kept: Kept,
        gains: FloatArray,
    ) -> None:
        """
        Args:
            model: of the robot.
            kept: a few instants of the recording.
            gains: ``(joints,)`` factors that the messages' efforts were multiplied by.
        """
        robot, samples = model.robot, kept.samples
        moves = np.std(samples.velocity, axis=0) > STANDING
        measured = np.mean(np.isfinite(samples.effort), axis=0) >= MEASURED
        changing = np.array([_changes(effort) for effort in samples.effort.T], dtype=bool)
        self._constant = [robot.joint_names[j] for j in np.flatnonzero(measured & moves & ~changing)]
        joints = np.flatnonzero(measured & changing)
        usable = _usable(samples, joints)
        used = Kept(samples.select(usable), kept.later.select(usable), kept.recordings[usable])
        self._subject = Subject.of(robot, used, joints, gains[joints])
        self._enough = np.count_nonzero(usable) >= FEWEST and bool(np.any(moves)) and len(joints) > 0
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
        finding, level = self._best(subject)
        if finding is None and level is not None:
            self.remarks.append(level.sentence)
            subject = subject.under(np.array(level.settings["gravity"]))
            finding, _ = self._best(subject)
        named = [*held, *([] if finding is None else [finding])]
        return named or _unexplained(subject)

    def _best(self, subject: Subject) -> tuple[Finding | None, Cause | None]:
        """What explains efforts better than that they are as they should be; and the same of what may only be remarked
        on: a base that is not level."""
        every = (*candidates(subject), *changes(subject), *lags(subject))
        tried = [Tried.of(candidate, subject) for candidate in every]
        better = sorted((one for one in tried if one.allowed and one.gain > 0.0), key=lambda one: -one.gain)
        best = next((one for one in better if one.repeats()), None)
        sigmas = subject.nominal.sigmas if best is None else best.judged.sigmas
        if np.all(sigmas > FOLLOWS):
            return Finding(cause=Cause.of("unrelated", subject.names)), None
        level = max((o for o in tried if not o.candidate.alone and o.is_named), key=lambda o: o.gain, default=None)
        finding, remark = decide(tried)
        if remark and remark not in self.remarks:
            self.remarks.append(remark)
        return finding, None if level is None else level.cause


def _unexplained(subject: Subject) -> list[Finding]:
    """The joints whose efforts no links and no friction explain, and curves of their motion hardly do, whatever the
    reason."""
    curved = subject.flexible.nominal.sigmas > FOLLOWS
    residuals = Residuals(
        names=subject.names,
        units=subject.units,
        positions=subject.samples.position[:, subject.joints],
        speeds=subject.samples.velocity[:, subject.joints],
        efforts=subject.measured,
        residuals=np.where(curved, subject.measured - subject.explained(subject.nominal), np.nan),
        before=np.full(len(subject.joints), np.inf),
    )
    found = residuals.finding(subject.spread, FOLLOWS)
    return [] if found is None else [found]


def _usable(samples: Samples, joints: IntArray) -> BoolArray:
    """The samples ``(N,)`` at which the efforts of all these joints are measured."""
    return np.asarray(np.all(np.isfinite(samples.effort[:, joints]), axis=1))


def _changes(effort: FloatArray) -> bool:
    """Whether an effort changes at all."""
    known = effort[np.isfinite(effort)]
    return bool(len(known) and np.ptp(known) > 1e-9 * np.max(np.abs(known)))
