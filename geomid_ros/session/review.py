"""Review of the recordings that a session read, and the verdict on its estimate. Links that are impossible for their
shapes in the URDF are reported."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.checks.causes import Cause, RecordingFault, as_faults
from geomid_ros.checks.definite_faults import encoder_zeros
from geomid_ros.checks.moving_base import displaced_imu, feet_of_fixed, never_lifted, turned_imu, unknown_base
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck, RunCheck, no_external_forces
from geomid_ros.checks.unexplained import residual_rms_in_motion, unexplained, unexplained_base
from geomid_ros.checks.verdict import (
    HEAVIER,
    Verdict,
    poorly_predicted,
    recording_verdict,
    verdict,
    worse_channels,
    worse_in_folds,
    worse_on_rows,
)
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate, LinkEstimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.shape_prior import OUTSIDE, Solid, UrdfInertial
from geomid_ros.model.shape_prior import verdict as verdict_on_shape
from geomid_ros.model.shapes import volume
from geomid_ros.model.urdf_tree import inertial_parameters, read_xml
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.gates import LEAP
from geomid_ros.signals.ledger import Account, Ledger, Meaning, Reason, meaning_of
from geomid_ros.signals.messages import IMU, message_type
from geomid_ros.signals.unitree import KINDS
from geomid_ros.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class RecordingFacts:
    """Facts about recordings in addition to their samples.

    Attributes:
        accounts: message counts, by topic.
        findings: suspected faults.
        remarks: remarks that are no faults, in sentences.
        unmeasured: joints whose efforts are missing.
        incomplete: missing parts of the recordings, in sentences.
        settled: choices made for the user, in sentences.
    """

    accounts: Mapping[str, Account] = field(default_factory=dict)
    findings: tuple[RecordingFault, ...] = ()
    remarks: tuple[str, ...] = ()
    unmeasured: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()
    settled: tuple[str, ...] = ()

    def plus(self, later: RecordingFacts) -> RecordingFacts:
        """Combine with ``later`` recordings: each sentence once, and the joints that are unmeasured in both."""
        ledger = Ledger()
        ledger.add(self.accounts)
        ledger.add(later.accounts)
        names = ("remarks", "incomplete", "settled")
        texts = {name: tuple(dict.fromkeys((*getattr(self, name), *getattr(later, name)))) for name in names}
        return RecordingFacts(
            accounts=ledger.topics,
            findings=tuple({finding.sentence: finding for finding in (*self.findings, *later.findings)}.values()),
            unmeasured=tuple(joint for joint in self.unmeasured if joint in later.unmeasured),
            **texts,
        )


_OFTEN = "; does the driver publish more often than it measures? What repeats is left out, the rest serves"


def faulty_streams(accounts: Mapping[str, Account], before: Mapping[str, Account]) -> list[RecordingFault]:
    """Driver faults that make all messages of a topic doubtful.

    Args:
        accounts: by topic.
        before: the accounts at an earlier time; faults counted until then are ignored.
    """
    return [
        RecordingFault(cause=Cause(kind="stream", sentence=f"{topic}: {remark.sentence}", places=(topic,)))
        for topic, account in accounts.items()
        for remark in account.noted - before.get(topic, Account()).noted
        if isinstance(remark, Reason) and remark.meaning == "driver error"
    ]


def is_continuous(accounts: Mapping[str, Account]) -> bool:
    """True if no positions jump, by the accounts of all topics."""
    return not any(LEAP in account.noted for account in accounts.values())


def peculiarities(accounts: Mapping[str, Account]) -> list[str]:
    """Remarks on refused or peculiar messages of topics whose other messages can be used."""
    remarks = []
    for topic, account in accounts.items():
        if refused := (+account.rejected).total():
            ((reason, count),) = account.rejected.most_common(1)
            summary = f"{topic}: {refused} of {account.received} messages are refused"
            often = _OFTEN if meaning_of(reason) == "repeated" else ""
            remarks.append(f"{summary}, {'all' if count == refused else count} of them: {reason}{often}")
    return [*remarks, *_noted(accounts, "told")]


def _noted(accounts: Mapping[str, Account], meaning: Meaning) -> list[str]:
    """Remarks of this meaning, with their topics."""
    return [f"{topic}: {r}" for topic, account in accounts.items() for r in account.noted if meaning_of(r) == meaning]


_DENSEST = 22_590.0
"""Density of osmium [kg/m^3]; no material is denser."""


def impossible_links(urdf: str, source: str, links: Iterable[LinkEstimate]) -> Iterator[str]:
    """Yield a sentence for each link that is denser than any material, or has mass outside of its shape.

    Links without a readable shape, and links with merged ones, pass. So do links whose URDF mass is outside, too: then
    the shape does not describe it.

    Args:
        urdf: text of the robot description.
        source: its origin, from which meshes are searched.
        links: the links to check.
    """
    for link in links:
        element = next(each for each in read_xml(urdf, source).findall("link") if each.get("name") == link.name)
        solid = None if link.merged else _solid(element, source)
        if solid is None:
            continue
        density = link.mass / volume(solid.moments)
        if density > _DENSEST:
            yield (
                f"link '{link.name}' has a mass of {link.mass:.3g} kg, i.e. a density of {density:.3g} kg/m^3 in its "
                f"URDF shape; the densest material has {_DENSEST:.0f}"
            )
        elif _is_outside(link.parameters, solid) and not _is_outside(inertial_parameters(element, source), solid):
            yield f"link '{link.name}' has mass outside of its URDF shape"


def _is_outside(parameters: FloatArray | None, solid: Solid) -> bool:
    """True if a body ``(10,)`` has mass outside of a solid."""
    own = UrdfInertial(parameters, "")
    return verdict_on_shape(own, solid, own.mass / volume(solid.moments)) == OUTSIDE


def _solid(link: Element, source: str) -> Solid | None:
    """Solid that a link's shapes fill; None if none can be read."""
    # Few results need it, and importing the mesh reader takes a third of a second.
    from geomid_ros.files.shapes import ShapeReader  # noqa: PLC0415

    try:
        return ShapeReader(Path(source), {}).solid(link)
    except (InputError, OSError, ImportError):
        return None


@dataclass(frozen=True)
class LeftOut:
    """Part of the recording at a ``path`` that is left out: stamps [ns] from ``begin`` up to ``end``, excluded; a
    ``sentence`` tells why."""

    path: Path
    begin: int
    end: int
    sentence: str


class Review:
    """Checks of a robot's recordings as a whole, and their findings."""

    def __init__(
        self,
        model: MeasurementModel,
        loaded: LoadedModel,
        configuration: Configuration,
        controller: PDController | None,
        ledger: Ledger,
    ) -> None:
        """Begin without recordings of this ``model``, which began with the ``loaded`` one; the ``ledger`` counts
        messages."""
        self._model, self._robot, self._loaded, self._ledger = model, model.robot, loaded, ledger
        self._controller, self._has_imu = controller, bool(configuration["imu.frame"])
        joints = self._robot.joint_names
        names = {s.topic: name for name, s in zip(configuration["wrenches"], configuration.sensors, strict=True)}
        gains = configuration.signals(joints).effort_gains(joints)
        # A separate model: checks run in another thread than rows, and pinocchio's buffers must not be shared.
        self._own_model = model.with_gravity(self._robot.gravity)
        self.new_check = partial(RecordingCheck, CheckTask(self._own_model, gains, names, controller))
        """Creates a check of other recordings of this robot."""
        self.check = self.new_check()
        """Collects all samples, and checks them as a whole."""
        self.findings: tuple[RecordingFault, ...] = ()
        """Suspected faults of the recording as a whole."""
        self.unconfirmed = ""
        """Why no later data confirm the estimates of a stream yet; empty if they do, and for recordings."""
        self.settled: list[str] = []
        """Choices made for the user, in sentences."""
        self.left_out: tuple[LeftOut, ...] = ()
        """Parts of the recordings that were left out."""
        self._kept: tuple[RecordingFault, ...] = ()  # findings on recordings that are checked separately
        self._validated: tuple[str, ...] = ()  # sentences on recordings that are only evaluated on
        self._sound: list[RecordingCheck] = []  # checks of those in which nothing is wrong
        self._forgotten: dict[str, Account] = {}  # the ledger's counts when findings were forgotten
        self._incomplete: list[str] = []  # sentences on missing parts of the recordings that were read
        self._imus: list[str] = []  # IMU topics in the recordings
        self._elsewhere = RecordingFacts()  # facts about recordings read by another session

    def judge(self) -> None:
        """Check the recording as a whole, by the samples that :attr:`check` has collected so far."""
        check = self.check
        topics = self._ledger.topics
        findings = check.findings(continuous=is_continuous(topics))
        if check is self.check:  # nothing was forgotten meanwhile
            findings = (*self._kept, *findings, *faulty_streams(topics, self._forgotten))
            findings = (*(self._moving_base() if findings else ()), *findings)
            self.findings = tuple({finding.sentence: finding for finding in findings}.values())

    def _moving_base(self) -> tuple[RecordingFault, ...]:
        """One finding that the base may move, if it counts as fixed and an IMU was recorded; else none. If the robot
        stands on its legs, nothing can be identified."""
        if self._robot.floating_base or not self._imus:
            return ()
        imu, fixed, kept = self._imus[0], self._robot, self.check.recorded
        locked, gravity = [*fixed.locked_joints], fixed.gravity
        robot = Robot(fixed.urdf, floating_base=True, locked_joints=locked, gravity=gravity, source=fixed.source)
        kind = "base"
        reason = "efforts are not those of a robot whose base is fixed: if the base moves, say"
        contacts = "FOOT:RADIUS,..."
        if feet := feet_of_fixed(robot, kept) if kept is not None else []:
            kind = "description"
            reason = "the efforts of the legs support the robot's weight: its base is not fixed. Say"
            contacts = ",".join(f"{foot}:RADIUS" for foot in feet)
        sentence = f"the bag has an IMU ({imu}), and {reason} so with --imu {imu}:FRAME and --contacts {contacts}"
        return (RecordingFault(cause=Cause(kind=kind, sentence=sentence, places=(imu,))),)

    def judge_with(self, judge: RunCheck) -> None:
        """Use ``judge``, for example in another process, instead of :meth:`CheckTask.judge`. Call before
        samples."""
        self.new_check = partial(self.new_check, run_check=judge)
        self.check = self.new_check()

    def await_confirmation(self) -> None:
        """Doubt the estimates of a stream until data that came after one confirm it: those from few data may fit these
        alone."""
        self.unconfirmed = "no data that came after it have confirmed it yet"

    def confirm(self, estimate: Estimate, later: Sequence[Samples]) -> None:
        """Confirm estimates of a stream if one predicts ``later`` samples no worse than the URDF does."""
        worse = worse_channels(self._own_model, later, estimate.predictor)
        names = ", ".join(f"'{channel}'" for channel in worse)
        self.unconfirmed = f"the estimate before predicted later data worse than the URDF: {names}" if worse else ""

    def judge_validation(self, name: str, check: RecordingCheck, accounts: Mapping[str, Account]) -> None:
        """Remark on a recording that is not fitted; its faults are not those of the other recordings.

        Args:
            name: name of the recording.
            check: the check that has collected its samples.
            accounts: counts of its messages, by topic.
        """
        findings = (*check.findings(continuous=is_continuous(accounts)), *faulty_streams(accounts, {}))
        self._validated += tuple(f"{name} (validation bag): {finding.sentence}" for finding in findings)
        self._sound += [] if findings else [check]

    def forget(self) -> None:
        """Check only the samples to come."""
        self.check, self.findings, self._kept = self.new_check(), (), ()
        self._forgotten = self._ledger.topics

    def check_description(self) -> None:
        """Refuse a URDF that cannot be a robot's, or a base that is not fixed: an estimate is meaningless, and may take
        for ever.

        Raises:
            InputError: the recordings so far show that.
        """
        for finding in self.findings:
            if finding.cause.kind == "description":
                raise InputError(f"{self._robot.source or self._robot.name}: {finding.cause.sentence}")

    def check_separately(self) -> None:
        """Keep the findings so far; check later samples separately: an intended change between recordings is no
        fault."""
        kept = self.findings
        self.forget()
        self.findings = self._kept = kept

    def verdict(
        self, estimate: Estimate, judged: Sequence[Samples] | RowSummary = (), held_out: FloatArray | None = None
    ) -> Verdict:
        """Verdict on an estimate.

        Args:
            estimate: the estimate.
            judged: samples, or their rows, on which it is compared with the URDF; none to compare on its own rows.
            held_out: RMS residual ``(channels,)`` on held-out data; None if nothing was held out.
        """
        if isinstance(judged, RowSummary):
            worse = worse_in_folds(self._model, judged, estimate.predictor)
        else:
            worse = worse_channels(self._model, judged, estimate.predictor) if judged else worse_on_rows(estimate)
        recorded = self.recorded
        samples = () if isinstance(judged, RowSummary) else judged
        findings = self.findings
        if no_external_forces(self._model) and all(finding.cause.kind == "unexplained" for finding in findings):
            # Joints whose efforts the estimate does not explain.
            findings = as_faults(unexplained(self._model, samples, estimate.predictor, self.check.recorded)) or findings
        remarks = [*peculiarities(recorded.accounts), *self.remarks]
        if any(finding.cause.kind == "legs" for finding in findings):
            return replace(recording_verdict(findings, warnings=remarks), explains_all=True)
        if self._has_imu:
            remarks += turned_imu(self._model, estimate)
            findings = findings or as_faults(displaced_imu(self._model, samples, estimate.parameters))
        findings = findings or as_faults(unknown_base(self._model, estimate))
        findings = findings or as_faults(unexplained_base(self._model, samples, estimate.parameters))
        if held_out is not None and (poor := poorly_predicted(estimate, self._in_motion(estimate, samples, held_out))):
            changes = self._changes()
            remarks += [*poor, *(() if findings else (change.sentence for change in changes))]
            findings = findings and (changes or findings)
        if self._controller is not None:
            remarks += encoder_zeros(self._controller, estimate.effects, self._robot.joint_names)
        remarks += never_lifted(self._model, estimate)
        impossible = tuple(impossible_links(self._robot.urdf, self._robot.source, self._suspects(estimate)))
        return verdict(
            estimate,
            findings,
            self._model,
            degraded_channels=worse,
            unmeasured=recorded.unmeasured,
            effort_faults=remarks,
            doubts=(*impossible, *filter(None, [self.unconfirmed])),
        )

    def _in_motion(self, estimate: Estimate, samples: Sequence[Samples], held_out: FloatArray) -> FloatArray:
        """``held_out`` residual RMS ``(channels,)``; of joints' efforts while they move, if there are ``samples``."""
        joints = len(self._model.layout.efforts)
        if not samples or not joints:
            return held_out
        moving, _ = residual_rms_in_motion(self._model, samples, estimate.predictor.beside(estimate.parameters))
        return np.concatenate([moving[:, 0], held_out[joints:]])

    def _changes(self) -> tuple[RecordingFault, ...]:
        """Changes between sound recordings: those that were fitted, and others that were only evaluated on."""
        if self.findings:
            return ()
        return tuple(change for later in self._sound for change in self.check.changes_until(later))

    def _suspects(self, estimate: Estimate) -> Iterator[LinkEstimate]:
        """Links whose masses are far from the URDF's, except for end links, which may carry a payload."""
        masses = self._model.nominal_inertias[::10]
        for link, nominal in zip(estimate.links, masses, strict=True):
            far = link.outlier or not nominal / HEAVIER <= link.mass <= nominal * HEAVIER
            if far and len(self._robot.subtree(link.name)) > 1:
                yield link

    def warnings(self, estimate: Estimate | None = None, verdict: Verdict | None = None) -> list[str]:
        """Sentences on what makes results doubtful: the initial model, the estimate and its verdict."""
        reasons = verdict.warnings if verdict is not None else ()
        sentences = [
            self._loaded.warning,
            *reasons,
            *self._incomplete,
            *self._robot.inertia_repairs.values(),
            _massless(self._robot.massless_links),
            self._loaded.not_predicted if estimate is not None else "",
        ]
        if estimate is not None and not (verdict is not None and verdict.explains_all):
            sentences += estimate.warnings
        return [*filter(None, sentences)]

    @property
    def notes(self) -> list[str]:
        """Remarks in sentences that do not make results doubtful."""
        return [*self._settled, *_noted(self._ledger.topics, "note")]

    @property
    def _settled(self) -> tuple[str, ...]:
        return (*self.settled, *(part.sentence for part in self.left_out))

    def begin_recording(self, bag: Bag) -> None:
        """Note that the samples to come are from another recording, and which parts of it are missing."""
        self.check.begin_recording(bag.path.name)
        self._imus += [topic for topic, kind in bag.topics.items() if kind in (message_type(IMU), *KINDS[IMU])]
        self._incomplete += [warning for warning in bag.warnings if warning not in self._incomplete]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the recordings that are no faults, in sentences."""
        return (*self._elsewhere.remarks, *self.check.remarks, *self._validated)

    @property
    def recorded(self) -> RecordingFacts:
        """Facts about all recordings in addition to their samples."""
        elsewhere = self._elsewhere
        return RecordingFacts(
            accounts=self._ledger.topics,
            findings=self.findings,
            remarks=self.remarks,
            unmeasured=(*elsewhere.unmeasured, *self.check.unmeasured),
            incomplete=tuple(self._incomplete),
            settled=self._settled,
        )

    def read_elsewhere(self, recorded: RecordingFacts) -> None:
        """Add recordings that another session read, whose rows the identifier receives."""
        self._elsewhere = recorded
        self._ledger.add(recorded.accounts)
        self.findings = self._kept = recorded.findings
        self._incomplete += recorded.incomplete
        self.settled += recorded.settled


def _massless(links: Sequence[str]) -> str:
    if not links:
        return ""
    listing = f"'{links[0]}'" + (f" (and {len(links) - 1} other links)" if len(links) > 1 else "")
    return (
        f"{listing} moves without a mass in the URDF: it is not identified, and its mass is attributed to other links; "
        "give it an <inertial> ('geomid prior' computes it from shapes)"
    )
