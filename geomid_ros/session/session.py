"""A robot under identification: from its description and a configuration to an identifier, and back to files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.checks.base import displaced_imu, never_lifted, turned_imu
from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.check import Judge, JudgementTask, RecordingCheck, efforts_alone
from geomid_ros.checks.obvious import encoder_zeros
from geomid_ros.checks.unexplained import unexplained
from geomid_ros.checks.verdict import (
    HEAVIER,
    Verdict,
    unlike,
    verdict,
    worse_channels,
    worse_in_folds,
    worse_on_rows,
)
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate, LinkEstimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.estimate_file import account_entry, estimate_document, verdict_entry
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.population import population_document, read_population
from geomid_ros.files.models.posterior import POSTERIOR, write_posterior
from geomid_ros.files.models.readers import ELEMENTS, URDF
from geomid_ros.files.models.urdf import with_effects, with_inertials
from geomid_ros.files.models.written_model import WrittenModel, handover_entry, written_model
from geomid_ros.model.absent_joints import lockable
from geomid_ros.model.alike_parts import AlikeParts, alike_parts, said_alike
from geomid_ros.model.columns import Column
from geomid_ros.model.controller import Controller
from geomid_ros.model.imu import ImuMount
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recording_facts import Recorded, faulty_streams, peculiarities
from geomid_ros.session.solidity import impossible_links
from geomid_ros.signals.ledger import Account, Ledger
from geomid_ros.signals.limits import ACCELEROMETER_BIAS
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, Accepted, Recent, message_type
from geomid_ros.signals.pipeline import SignalPipeline, ignore
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.unitree import UnitreeMessages
from geomid_ros.types import FloatArray


class Session:
    """A robot under identification: its model, its signal pipeline and its identifier.

    The node, the command line and notebooks all identify by means of it.
    """

    def __init__(
        self,
        urdf: str,
        configuration: Configuration,
        source: str,
        ledger: Ledger | None = None,
        readers: Collection[str] = (),
        *,
        loaded: LoadedModel | None = None,
    ) -> None:
        """Build the model that description and configuration ask for.

        Args:
            urdf: text of the robot description.
            configuration: parameters.
            source: where the description is from, for messages.
            ledger: told what becomes of every message.
            readers: who will read the files of results, of :data:`~geomid_ros.files.models.effect_forms.ELEMENTS`.
            loaded: the model to start from; that of the configuration unless given.

        Raises:
            InputError: these do not fit together.
        """
        self.urdf = urdf
        self._source = source
        self.configuration = configuration
        self._readers = readers
        self.loaded = loaded or LoadedModel.read(configuration["model"])
        sensors = self.loaded.sensors(configuration.sensors)
        self._sensors = sensors
        self.robot = self.read_robot(urdf, source)
        self._controller = self._read_controller()
        effects = configuration.effects
        local = self.loaded.local_effects(effects)
        model = MeasurementModel(
            self.robot,
            effects,
            sensors,
            configuration["links"] or None,
            local,
            candidates=configuration.candidates,
            behind_gear=configuration.behind_gear(self.robot.joint_names),
            contacts=configuration.contacts,
            commanded=self._controller is not None,
        )
        self.model = model.with_known_loads(self.loaded.parameters(model))
        self._settings = self._estimator_settings(configuration)
        self.identifier = Identifier(self.model, self._settings, configuration.buffer, self._identified_prior)
        joints = self.robot.joint_names
        named = {s.topic: name for name, s in zip(configuration["wrenches"], configuration.sensors, strict=True)}
        gains = configuration.signals(joints).effort_gains(joints)
        # Judged in another thread than rows are made in: pinocchio's buffers are not shared.
        own = self.model.with_gravity(self.robot.gravity)
        self.new_check = partial(RecordingCheck, JudgementTask(own, gains, named, self._controller))
        """Makes a check of other recordings of this robot."""
        self.check = self.new_check()
        """Told of all samples, it judges them as a whole."""
        self.findings: tuple[Finding, ...] = ()
        """What seems to be wrong with the recording as a whole."""
        self._kept: tuple[Finding, ...] = ()  # of recordings that are judged apart
        self._validated: tuple[str, ...] = ()  # sentences on recordings that are only judged on
        self._forgotten: dict[str, Account] = {}  # what the ledger had counted when findings were forgotten
        self.warm: WarmStart | None = None
        """Where the next solve may begin: the last estimate."""
        self.settled: list[str] = []
        """What was settled for the user, in sentences."""
        self.joints_heard: set[str] = set()
        """The names of joints in all messages."""
        self._incomplete: list[str] = []  # sentences on the recordings that were read
        self._unchecked: list[str] = []  # their names
        self._imus: list[str] = []  # topics in the recordings
        self._elsewhere = Recorded()  # of recordings that were read elsewhere
        self.recent = Recent(configuration["gap.memory"])
        self.pipeline = self.new_pipeline(on_accepted=self.recent, ledger=ledger)

    def _read_controller(self) -> Controller | None:
        """The gains that efforts are computed with; None if they are measured. Raises InputError."""
        try:
            return Controller.of(self.configuration.gains, self.robot.joint_names, self.configuration["command.delay"])
        except InputError as error:
            raise InputError(f"{self.configuration.source}: command.gains: {error}") from error

    def unitree(self) -> UnitreeMessages:
        """What makes other messages of those of a Unitree robot. Raises InputError naming what is wrong with its
        ``motors`` once there are such messages."""
        configuration = self.configuration
        return UnitreeMessages(configuration["motors"], self.robot.joint_names, self._controller, configuration.source)

    def read_robot(self, urdf: str, source: str) -> Robot:
        """The robot of a description with the same links and joints as this one's. Raises InputError naming the
        ``source``."""
        configuration = self.configuration
        return Robot(
            urdf,
            floating_base=configuration.floating_base,
            cuts=[sensor.frame for sensor in self._sensors if sensor.role == "mounted"],
            locked_joints=configuration["locked_joints"],
            gravity=self.loaded.gravity(configuration.gravity),
            source=source,
        )

    @property
    def prior(self) -> FloatArray | None:
        """The parameters ``(D,)`` of an earlier estimate to start from, NaN where it has none; None without one."""
        return self.loaded.parameters(self.model)

    @property
    def _identified_prior(self) -> FloatArray | None:
        """The same without coefficients that an identification no longer finds: files of before have an excess of
        Stribeck friction that is negative."""
        if (prior := self.prior) is None:
            return None
        positive = np.array([c.positive for c in self.model.coefficients], dtype=bool)
        first = len(prior) - len(positive)
        return np.append(prior[:first], np.where(positive & (prior[first:] <= 0.0), np.nan, prior[first:]))

    def use(self, configuration: Configuration) -> None:
        """Solve by another configuration of the same rows from now on. Raises InputError, and changes nothing, if it
        does not fit."""
        settings = self._estimator_settings(configuration)
        self.identifier.use(settings)
        self.configuration, self._settings = configuration, settings

    def _estimator_settings(self, configuration: Configuration) -> EstimatorSettings:
        """With the population that is the prior. Raises InputError where several priors are given, or none fits."""
        settings = configuration.estimator([channel.name for channel in self.model.channels])
        files = {reader: ELEMENTS[reader] for reader in self._readers}
        settings = replace(settings, files=files, alike=self._alike(configuration))
        if not (path := configuration["prior"]):
            return settings
        for other, given in (("model", self.loaded.source), ("gamma", configuration["gamma"])):
            if given:
                raise InputError(f"{configuration.source}: prior and {other} are both given; choose one")
        return replace(settings, population=read_population(Path(path)))

    def _alike(self, configuration: Configuration) -> tuple[AlikeParts, ...]:
        known = self.loaded.source or configuration["prior"] or configuration["gamma"]
        if configuration["alike"] == "urdf" and not known:
            return alike_parts(self.model.robot, self.model.identified)
        return ()

    @property
    def alike(self) -> tuple[AlikeParts, ...]:
        """Links that are alike, if the prior is that of the URDF."""
        return self._settings.alike

    def judge(self) -> None:
        """Judge the recording as a whole, by the samples that :attr:`check` was told of so far."""
        check = self.check
        found = check.findings()
        if check is self.check:  # nothing was forgotten meanwhile
            found = (*self._kept, *found, *faulty_streams(self.pipeline.ledger.topics, self._forgotten))
            found = (*(self._moving_base() if found else ()), *found)
            self.findings = tuple({finding.sentence: finding for finding in found}.values())

    def _moving_base(self) -> tuple[Finding, ...]:
        """That the base may move, if it counts as fixed and an IMU was recorded."""
        if self.robot.floating_base or not self._imus:
            return ()
        imu = self._imus[0]
        sentence = (
            f"the bag has an IMU ({imu}), and efforts are not those of a robot whose base is fixed: if the base moves, "
            f"say so with --imu {imu}:FRAME and --contacts FOOT:RADIUS,..."
        )
        return (Finding(cause=Cause(kind="base", sentence=sentence, places=(imu,))),)

    def judge_with(self, judge: Judge) -> None:
        """Judge by ``judge`` instead of :meth:`JudgementTask.judge`, in another process for example, before there are
        samples."""
        self.new_check = partial(self.new_check, judge=judge)
        self.check = self.new_check()

    def judge_validation(self, name: str, check: RecordingCheck, accounts: Mapping[str, Account]) -> None:
        """Remark on a recording that is not fitted: what is wrong with it is no fault of the others.

        Args:
            name: of the recording.
            check: that was told of its samples.
            accounts: of its messages, by topic.
        """
        found = (*check.findings(), *faulty_streams(accounts, {}))
        self._validated += tuple(f"{name}, which is judged on: {finding.sentence}" for finding in found)

    def forget_findings(self) -> None:
        """Judge by the samples to come alone."""
        self.check, self.findings, self._kept = self.new_check(), (), ()
        self._forgotten = self.pipeline.ledger.topics

    def check_description(self) -> None:
        """Refuse a URDF that can be no robot's: what is solved for from there says nothing, and may take for ever.

        Raises:
            InputError: the recordings so far have shown that.
        """
        for finding in self.findings:
            if finding.cause.kind == "description":
                raise InputError(f"{self._source or self.robot.name}: {finding.cause.sentence}")

    def judge_apart(self) -> None:
        """Keep the findings so far, and judge the samples to come by themselves: what was changed on purpose between
        two recordings is no fault of theirs."""
        kept = self.findings
        self.forget_findings()
        self.findings = self._kept = kept

    def verdict(
        self, estimate: Estimate, judged: Sequence[Samples] | RowSummary = (), held_out: FloatArray | None = None
    ) -> Verdict:
        """Whether an estimate can be used.

        Args:
            estimate: what was found.
            judged: samples, or their rows, on which it is compared with the URDF; none to compare on its own rows.
            held_out: RMS ``(channels,)`` of what it leaves on held-out data; None if nothing was held out.
        """
        if isinstance(judged, RowSummary):
            worse = worse_in_folds(self.model, judged, estimate.parameters)
        else:
            worse = worse_channels(self.model, judged, estimate.parameters) if judged else worse_on_rows(estimate)
        recorded = self.recorded
        samples = () if isinstance(judged, RowSummary) else judged
        named = any(finding.cause.kind != "unexplained" for finding in self.findings)
        findings = self.findings if named else self._unexplained(estimate, samples) or self.findings
        peculiar = [*peculiarities(recorded.accounts), *self.remarks]
        if self.base_topic == IMU:
            peculiar += turned_imu(self.model, estimate)
            findings = findings or displaced_imu(self.model, samples, estimate.parameters)
        if self._controller is not None:
            peculiar += encoder_zeros(self._controller, estimate.effects, self.robot.joint_names)
        peculiar += never_lifted(self.model, estimate)
        peculiar += [] if held_out is None else unlike(estimate, held_out)
        impossible = tuple(impossible_links(self.urdf, self._source, self._suspects(estimate)))
        return verdict(
            estimate,
            findings,
            self.model,
            worse=worse,
            unmeasured=recorded.unmeasured,
            peculiar=peculiar,
            impossible=impossible,
        )

    def _suspects(self, estimate: Estimate) -> Iterator[LinkEstimate]:
        """The links whose masses are far from the URDF's, but for those at the ends, which may carry what is not in
        it."""
        masses = self.model.nominal_inertias[::10]
        for link, nominal in zip(estimate.links, masses, strict=True):
            far = link.outlier or not nominal / HEAVIER <= link.mass <= nominal * HEAVIER
            if far and len(self.robot.subtree(link.name)) > 1:
                yield link

    def _unexplained(self, estimate: Estimate, judged: Sequence[Samples]) -> tuple[Finding, ...]:
        """That an estimate does not explain what some joints do, if so."""
        if not efforts_alone(self.model):
            return ()
        return unexplained(self.model, judged, estimate.parameters, self.check.recorded)

    def warnings(self, estimate: Estimate | None = None, verdict: Verdict | None = None) -> list[str]:
        """What makes results doubtful, in sentences: of the model it began with, of an estimate and its verdict."""
        judged = verdict.warnings if verdict is not None else ()
        found = [
            self.loaded.doubt,
            *judged,
            *self._incomplete,
            *self.robot.repaired.values(),
            *([_massless(self.robot.massless)] if self.robot.massless else []),
            self.loaded.not_predicted if estimate is not None else "",
        ]
        return [*filter(None, found), *(estimate.warnings if estimate is not None else ())]

    @property
    def lockable(self) -> tuple[str, ...]:
        """The joints that none of the messages so far names, if they may count as fixed at zero."""
        return lockable(self.robot, frozenset(self.joints_heard), [sensor.frame for sensor in self.model.sensors])

    @property
    def notes(self) -> list[str]:
        """What is worth knowing, in sentences, and casts no doubt on results."""
        names = ", ".join(dict.fromkeys(self._unchecked))
        unchecked = [f"{names}: no CRCs; corruption cannot be detected"] if names else []
        return [*self.settled, *unchecked, *said_alike(self.alike)]

    def begin_recording(self, bag: Bag) -> None:
        """Note that the samples to come are of another recording, and what is missing of it."""
        self.check.begin_recording()
        self._imus += [topic for topic, kind in bag.topics.items() if kind == message_type(IMU)]
        self._incomplete += [warning for warning in bag.warnings if warning not in self._incomplete]
        self._unchecked += [] if bag.checked else [bag.path.name]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to know of the recordings although nothing is wrong, in sentences."""
        return (*self._elsewhere.remarks, *self.check.remarks, *self._validated)

    @property
    def recorded(self) -> Recorded:
        """What is known of all recordings beside their samples."""
        elsewhere = self._elsewhere
        return Recorded(
            accounts=self.pipeline.ledger.topics,
            findings=self.findings,
            remarks=self.remarks,
            unmeasured=(*elsewhere.unmeasured, *self.check.unmeasured),
            incomplete=tuple(self._incomplete),
            unchecked=tuple(self._unchecked),
            settled=tuple(self.settled),
        )

    def read_elsewhere(self, recorded: Recorded) -> None:
        """Take note of recordings that another session read, whose rows the identifier is given."""
        self._elsewhere = recorded
        self.pipeline.ledger.add(recorded.accounts)
        self.findings = self._kept = recorded.findings
        self._incomplete += recorded.incomplete
        self._unchecked += recorded.unchecked
        self.settled += recorded.settled

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that data are expected on, as the pipeline calls them."""
        base = (self.base_topic,) if self.robot.floating_base else ()
        commands = () if self._controller is None else (COMMANDS,)
        return (JOINT_STATES, *commands, *base, *(sensor.topic for sensor in self.model.sensors))

    @property
    def meaning(self) -> dict[str, Any]:
        """What the rows depend on, by name, as JSON: rows of two sessions may be added up if they agree in it."""
        loaded, joints = self.loaded, self.robot.joint_names
        signals = loaded.signals(SignalSettings(), joints)
        corrections = {
            "effort_gain": signals.effort_gain,
            "effort_delay": signals.effort_delay,
            "wrench_offsets": [list(sensor.offset) for sensor in self.model.sensors],
            "gravity": loaded.gravity(self.configuration.gravity).tolist(),
            "effects": [[c.effect.name, c.place_name, vars(c.effect)] for c in self.model.coefficients],
        }
        urdf = hashlib.sha256(self.urdf.encode(errors="replace")).hexdigest()
        return {"robot_description": urdf, **self.configuration.of_rows, "model": corrections}

    @property
    def effort_gains(self) -> FloatArray:
        """Factors ``(joints,)`` from the messages' efforts to N m (or N), with what is known of the sensors."""
        return self.signals.effort_gains(self.robot.joint_names)

    @property
    def signals(self) -> SignalSettings:
        """The configuration's, with what is known of the sensors."""
        joints = self.robot.joint_names
        return self.loaded.signals(self.configuration.signals(joints), joints)

    def new_pipeline(
        self,
        settings: SignalSettings | None = None,
        effect_columns: tuple[Column, ...] | None = None,
        on_accepted: Callable[[Accepted], None] = ignore,
        ledger: Ledger | None = None,
    ) -> SignalPipeline:
        """A fresh pipeline, for another recording of the same robot.

        Args:
            settings: the configuration's, unless given.
            effect_columns: the columns to compute; those of the model's effects, unless given.
            on_accepted: called with every message that is accepted.
            ledger: told what becomes of every message.
        """
        joints = self.robot.joint_names
        return SignalPipeline(
            joints,
            floating_base=self.robot.floating_base,
            sensors=self.model.sensors,
            settings=self.loaded.signals(settings, joints) if settings else self.signals,
            continuous=[joint.name for joint in self.robot.joints if joint.continuous],
            turning=[joint.name for joint in self.robot.joints if joint.unit == "N m"],
            limits=np.array([self.robot.speed_limits, self.robot.effort_limits]),
            effect_columns=effect_columns or self.model.columns,
            on_accepted=on_accepted,
            ledger=ledger,
            joints_heard=self.joints_heard,
            mount=self._imu_mount,
            loads=None if self.model.legs is None else self.model.legs.loads,
            controller=self._controller,
        )

    @property
    def base_topic(self) -> str:
        """On which a floating base's motion comes, as the pipeline calls it."""
        return IMU if self.configuration["imu.frame"] else ODOM

    @property
    def share_of_mass(self) -> float:
        """By which the total mass differs between two recordings, a standard deviation: what accelerometers show
        otherwise along gravity is taken for it. Zero without one."""
        gravity = float(np.linalg.norm(self.robot.gravity))
        return np.sqrt(2.0) * ACCELEROMETER_BIAS / gravity if self.base_topic == IMU else 0.0

    @property
    def _imu_mount(self) -> ImuMount | None:
        """Where the IMU is. Raises InputError if it is not on the base."""
        frame = self.configuration["imu.frame"]
        if not frame:
            return None
        try:
            placement = self.robot.base_placement(frame)
        except InputError as error:
            raise InputError(f"{self.configuration.source}: imu.frame: {error}") from error
        return ImuMount(placement[:3, :3], placement[:3, 3], self.robot.gravity)

    def rms(self, batches: Iterable[Samples], parameters: FloatArray) -> FloatArray:
        """RMS residual of each channel over samples at parameters ``(D,)``; NaN where nothing was measured."""
        squares = np.zeros(len(self.model.channels))
        counts = np.zeros(len(self.model.channels))
        for samples in batches:
            measured, predicted = self.model.predict(samples, parameters)
            squares += np.nansum((measured - predicted) ** 2, axis=0)
            counts += np.count_nonzero(np.isfinite(measured), axis=0)
        return np.sqrt(np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0))

    def checkpoint(self) -> Checkpoint:
        """All that is known so far, to be written to disk."""
        return Checkpoint(self.meaning, self.identifier.memory(), self.pipeline.ledger.topics, self.warm, self._solving)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from the rows of a checkpoint of the same meaning, and from its estimate if it was solved for in the
        same way.

        Raises:
            InputError: they do not fit; nothing is changed then.
        """
        warm = checkpoint.warm
        if warm is not None and warm.parameters.shape != (self.model.dimension,):
            raise InputError(f"an estimate of {warm.parameters.size} parameters, expected {self.model.dimension}")
        self.identifier.restore(checkpoint.memory)
        self.warm = warm if checkpoint.solving == self._solving else None

    @property
    def _solving(self) -> str:
        """A checksum of what a solve depends on beside the rows."""
        prior, population = self.prior, self._settings.population
        text = f"{replace(self._settings, population=None)} {prior.tolist() if prior is not None else None}"
        if population is not None:  # whose arrays are printed shortened
            text += json.dumps(population_document(population))
        return hashlib.sha256(text.encode(errors="replace")).hexdigest()

    def document(
        self, estimate: Estimate, held_out: FloatArray | None = None, verdict: Verdict | None = None
    ) -> dict[str, Any]:
        """The document of ``estimate.json``.

        Args:
            estimate: what was found.
            held_out: RMS residual of each channel on held-out data ``(channels,)``, if there are any.
            verdict: whether it can be used; that of :meth:`verdict` unless given.
        """
        rejected = dict(self.identifier.rows_rejected)
        document = estimate_document(estimate, rejected, held_out, self.loaded.effects)
        judged = verdict or self.verdict(estimate)
        merged = {link.name: link.merged for link in estimate.links}
        return document | {
            "robot": self.robot.name,
            "verdict": verdict_entry(judged, self.findings),
            "warnings": self.warnings(estimate, judged),
            "notes": self.notes,
            "messages": {topic: account_entry(account) for topic, account in self.pipeline.ledger.topics.items()},
            "gravity": self.configuration.gravity.tolist(),
            "handover": {
                reader: handover_entry(self.written_model(estimate, reader), merged) for reader in estimate.within
            },
        }

    def written_model(self, estimate: Estimate, reader: str) -> WrittenModel:
        """The model that is written for a ``reader``."""
        return written_model(self.model, estimate, reader, self.loaded.effects)

    def identified_urdf(self, estimate: Estimate) -> str:
        """The robot description with the inertias and friction that were fitted for a URDF; every other character of it
        is kept."""
        written = self.written_model(estimate, URDF)
        return with_effects(self.with_inertias_of(estimate, written), written.effects)

    def with_inertias_of(self, estimate: Estimate, written: WrittenModel) -> str:
        """The robot description with the inertias of a written model of an estimate, and its friction as it was."""
        merged = [name for link in estimate.links for name in link.merged]
        return with_inertials(self.urdf, written.inertias, merged)

    def save(
        self,
        folder: Path,
        estimate: Estimate,
        held_out: FloatArray | None = None,
        verdict: Verdict | None = None,
    ) -> list[Path]:
        """Write ``estimate.json``, see :meth:`document`, ``identified.urdf`` and ``posterior.npz`` into a folder.

        Returns their paths.
        """
        document, description = folder / "estimate.json", folder / "identified.urdf"
        write_text(description, self.identified_urdf(estimate))
        posterior = write_posterior(folder / POSTERIOR, estimate.posterior)
        write_json(document, self.document(estimate, held_out, verdict))
        return [document, description, *posterior]


def _massless(links: Sequence[str]) -> str:
    named = f"'{links[0]}'" + (f" (and {len(links) - 1} other links)" if len(links) > 1 else "")
    return (
        f"{named} moves without a mass in the URDF: it is not identified, and what it weighs is put down to other "
        "links; give it an <inertial> ('geomid prior' does)"
    )
