"""The check of a recording as a whole: takes samples as they come, and says what the recording seems to be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.candidates import Tried, decide
from geomid_ros.checks.causes import MODEL, Cause, Finding
from geomid_ros.checks.changes import changes, lags
from geomid_ros.checks.evidence import FOLLOWS, LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST, Instants, Kept, Stretch
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.transforms import REASON, STANDARD_GRAVITY, candidates
from geomid_ros.checks.unexplained import Residuals
from geomid_ros.checks.wrenches import WrenchSensorCheck, can_be_judged
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.moving import SIGN, STILL
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.types import BoolArray, FloatArray, IntArray

MEASURED = 0.5
"""The least share of instants at which the effort of a joint that is judged is measured."""
_SAME = 1e-6  # of a range: what changes less stays exactly the same
_FEWEST = (
    5  # instants in a row; and at the ends of a stretch, at which a filter makes a motion of the step that follows
)
_PART = 0.1  # of a range that something changes by


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
        if not findings:  # a motion that is not the robot's would be the sensors' fault, too
            findings = [found for sensor in self.model.mounted if (found := self._wrench(sensor, excerpt))]
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
        return [name for name, share in zip(model.robot.joint_names, shares, strict=True) if share < MEASURED]


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
        moves = np.std(samples.velocity, axis=0) > STILL
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


def impossible_description(subject: Subject) -> Cause | None:
    """What is wrong with the URDF, whatever was measured: lengths, centres of mass and radii of gyration that are not
    of one robot, masses that joints of such limits could not carry, or that no steel could have."""
    robot = subject.robot
    bodies = np.array([body.parameters for body in robot.bodies])
    distances = np.linalg.norm(bodies[:, 1:4], axis=1) / bodies[:, 0]
    radii = np.sqrt([0.5 * np.trace(pseudo_inertia.central_inertia(body)) / body[0] for body in bodies])
    length, total = _length(subject), float(np.sum(bodies[:, 0]))
    whole = f"though all links together are {length:.3g} m long"
    weighs = f"the links weigh {total:.3g} kg in total, and "
    if np.median(_denser_than_steel(bodies)) > 0.0:
        return _lengths([], f"{weighs}most of its links would be denser than steel", "the masses", "grams", "kg")
    for sizes, what, quantity, unit, right in (
        (distances, "the centre of mass of link '{}' is {:.3g} m from its frame", "centres of mass", "mm", "m"),
        (radii, "the moments of inertia of link '{}' are those of mass {:.3g} m away from its centre",
         "moments of inertia", "g mm^2 or kg mm^2", "kg m^2"),
    ):  # fmt: skip
        most = int(np.argmax(sizes))
        if 0.0 < REASON**2 * length < sizes[most]:
            said = f"{what.format(robot.body_names[most], sizes[most])}, {whole}"
            return _lengths([robot.body_names[most]], said, quantity, unit, right)
    if length > REASON**2 * float(np.sum(radii)) > 0.0:
        said = f"all links together are {length:.3g} m long, though their mass is within {np.max(radii):.3g} m"
        return _lengths([], said, "the origins of joints", "mm", "m")
    with np.errstate(divide="ignore"):
        excess = _weights(subject) / robot.effort_limits
    joint = int(np.argmax(excess))
    if excess[joint] > REASON**2:
        said = f"{weighs}joint '{robot.joint_names[joint]}' would carry {excess[joint]:.0f} times its limit"
        return _lengths([], said, "the masses", "grams", "kg")
    return None


def _lengths(links: list[str], what: str, quantity: str, unit: str, right: str) -> Cause:
    return Cause.of("description", links, said="lengths", what=what, quantity=quantity, unit=unit, right=right)


def _length(subject: Subject) -> float:
    """The sum of all distances from a joint to the next, where all positions are zero."""
    robot, first = subject.robot, subject.samples.select(slice(1))
    frames = robot.link_frames(replace(first, position=np.zeros_like(first.position)))
    return float(sum(np.linalg.norm(frames[j.child][1] - frames[j.parent][1]) for j in robot.tree.joints))


def _weights(subject: Subject) -> FloatArray:
    """The largest efforts of the URDF's links at rest where the robot was, within its limits, whatever gravity is said
    to be ``(joints,)``."""
    samples, gravity, weights = subject.samples, subject.robot.gravity, np.zeros(len(subject.robot.joints))
    within = replace(samples, position=np.clip(samples.position, *subject.robot.position_limits.T))
    on_earth = STANDARD_GRAVITY / max(float(np.linalg.norm(gravity)), STANDARD_GRAVITY)
    weights[subject.joints] = on_earth * np.max(np.abs(subject.with_samples(within).weight), axis=0)
    return weights


def _denser_than_steel(bodies: FloatArray) -> BoolArray:
    """Whether bodies ``(B, 10)`` are smaller than steel balls of their masses."""
    traces = [np.trace(pseudo_inertia.central_inertia(body)) for body in bodies]  # twice that of the second moments
    least = [6.0 * body[0] * pseudo_inertia.least_gyration(body[0]) ** 2 for body in bodies]
    return np.asarray(np.array(traces) < np.array(least))


def held_efforts(subject: Subject) -> list[Cause]:
    """The efforts that stay the same for a while in which gravity and motion ask for others."""
    found, rigid, stamps = [], subject.flexible.rigid, subject.samples.stamps
    for channel, effort in enumerate(subject.measured.T):
        changes = np.abs(np.diff(rigid[:, channel]))
        same = np.abs(np.diff(effort)) <= _SAME * np.ptp(effort)
        begins = np.flatnonzero(np.diff(same.astype(np.int8), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(same.astype(np.int8), append=0) == -1) + 1
        for begin, end in zip(begins, ends, strict=True):
            others = np.delete(same & (changes > _PART * np.std(effort)), np.arange(begin, end))
            asked = float(np.ptp(rigid[begin : end + 1, channel]))
            if end - begin >= _FEWEST and np.mean(others) < _PART and asked > np.std(effort):
                times = {name: (stamps[at] - stamps[0]) * 1e-9 for name, at in (("begin", begin), ("end", end))}
                found.append(Cause.of("constant", [subject.names[channel]], said="held", asked=asked, **times))
                break
    return found


def is_model(subject: Subject) -> bool:
    """Whether efforts are what the URDF predicts: without friction, without any error."""
    left = np.sqrt(np.mean((subject.measured - subject.predicted) ** 2, axis=0))
    return bool(np.all(left < 0.5 * LEAST_SIGMA * subject.spread))


def frozen_position(subject: Subject) -> Cause | None:
    """A joint whose position stands exactly still for long, while others move and efforts are not those of that pose.

    The links are fitted to the other instants, and predict these. Where a joint really stands still, its brake holds it
    without any effort or its effort may be off by dry friction, and no other effort is off. A robot that stands still
    as a whole tells nothing.
    """
    positions, efforts = subject.samples.position, subject.measured
    for joint, position in enumerate(positions.T):
        still = _longest_still(position)
        if _PART < np.mean(still) < 0.5 and np.count_nonzero(~still) >= FEWEST + 2 * _FEWEST:
            changes = np.ptp(efforts[still], axis=0) > _PART * np.ptp(efforts, axis=0)
            inside, outside = _left(subject, still)
            moving = np.ptp(positions[still], axis=0) > _PART * np.ptp(positions, axis=0)
            if np.any(moving) and np.any((inside > outside) & changes):
                return Cause.of("frozen", [subject.robot.joint_names[joint]], share=np.mean(still))
    return None


def _longest_still(position: FloatArray) -> BoolArray:
    """The instants ``(N,)`` of the longest stretch without any motion, less its ends, which filters smear."""
    moves = np.flatnonzero(np.abs(np.diff(position)) > _SAME * np.ptp(position))
    ends = np.concatenate([[-1], moves, [len(position) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    still = np.zeros(len(position), dtype=bool)
    still[ends[longest] + 2 : ends[longest + 1]] = True
    return still


def _left(subject: Subject, still: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The RMS of what links and friction, fitted to the other instants, leave of efforts beyond dry friction: at these
    instants, and at the others ``(C,)``."""
    smeared = np.convolve(still, np.ones(2 * _FEWEST + 1), mode="same") > 0.0
    others = subject.part(~smeared)
    found = others.nominal
    left = (subject.measured - subject.regressor @ others.links(found)) / others.spread
    left -= np.einsum("nck,ck->nc", subject.friction, found.friction)
    beyond = np.maximum(np.abs(left) - np.where(still[:, None], found.friction[:, 2], 0.0), 0.0)
    inside, outside = (np.sqrt(np.mean(beyond[chosen] ** 2, axis=0)) for chosen in (still, ~smeared))
    return inside, np.maximum(outside, found.sigmas)
