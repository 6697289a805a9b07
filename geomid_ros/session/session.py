"""A robot under identification: its rows, the review of its recordings, and the start of the next solve; and its
results as files: ``estimate.json``, the robot description, the posterior."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.checks.verdict import Verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.effects_file import tilted_gravity
from geomid_ros.files.models.estimate_file import account_entry, estimate_document, predictor_entry, verdict_entry
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import POSTERIOR, population_document, read_population, write_posterior
from geomid_ros.files.models.readers import ELEMENTS, URDF
from geomid_ros.files.models.urdf import with_absolute_files, with_effects, with_inertials
from geomid_ros.files.models.written_model import WrittenModel, handover_entry, written_model
from geomid_ros.model.alike_parts import alike_parts, alike_sentences
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Column, Samples
from geomid_ros.model.urdf_tree import parse
from geomid_ros.monitoring.payload_watch import WatchMemory
from geomid_ros.session.configuration import Configuration, naming
from geomid_ros.session.review import RecordingFacts, Review
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, AcceptedMessages, Recent
from geomid_ros.signals.pipeline import SignalPipeline, ignore
from geomid_ros.signals.settings import ACCELEROMETER_BIAS, SignalSettings
from geomid_ros.signals.unitree import UnitreeMessages
from geomid_ros.types import FloatArray

LIGHT = 0.1
"""Fraction of a mass that is negligible."""


class Session:
    """A robot under identification: its model, its signal pipeline and its identifier.

    The node, the command line and notebooks all use it to identify.
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
        loads: LoadedModel | None = None,
    ) -> None:
        """Begin without rows.

        Args:
            urdf: text of the robot description.
            configuration: parameters.
            source: origin of the description, for messages.
            ledger: counts what becomes of each message.
            readers: programs that will read the results, of :data:`~geomid_ros.files.models.readers.ELEMENTS`.
            loaded: the model to start from; that of the configuration unless given.
            loads: the robot whose bodies load the gears, and whose joints have friction beside the ground's forces; the
                model to start from, or the URDF, unless given.

        Raises:
            InputError: these do not fit together.
        """
        self.urdf = urdf
        self.source = source
        self.configuration = configuration
        self.loaded = loaded or LoadedModel.read(configuration["model"])
        self._sensors = self.loaded.corrected_sensors(configuration.sensors)
        locked = self.loaded.locked_joints(parse(urdf, source)) if self.loaded.merged else ()
        self.locked_joints = tuple(dict.fromkeys([*configuration["locked_joints"], *locked]))
        """Joints fixed at zero: those of the configuration, and those that were locked when the model was
        identified."""
        self.robot = self.read_robot(urdf, source)
        gains, delay = configuration.gains, configuration["command.delay"]
        key = f"{configuration.source}: command.gains"
        self.controller = naming(key, PDController.of, gains, self.robot.joint_names, delay)
        """Controller from which efforts are computed; None if they are measured."""
        effects = configuration.effects
        model = MeasurementModel(
            self.robot,
            effects,
            self._sensors,
            configuration["links"] or None,
            self.loaded.local_effects(effects),
            candidates=configuration.candidates,
            link_side_joints=configuration.behind_gear([joint.name for joint in self.robot.tree.joints]),
            contacts=configuration.contacts,
            commanded=self.controller is not None,
        )
        known = model.with_known_loads((loads or self.loaded).parameters(model))
        self.model = known.with_drive_gains(self.loaded.drive_gains(model.channels))
        self.received_joints: set[str] = set()
        """Names of joints in all messages so far."""
        self._readers = readers
        self.settings = self._estimator_settings(configuration)
        self.identifier = Identifier(self.model, self.settings, configuration.buffer, self._identified_prior)
        self.warm_start: WarmStart | None = None
        """Start of the next solve: the last estimate."""
        self.watch: WatchMemory | None = None
        """State of the payload watch, if there is one."""
        self.recent = Recent(configuration["gap.memory"], lambda: self.identifier.sample_count)
        self.pipeline = self.new_pipeline(on_accepted=self.recent, ledger=ledger)
        self.review = Review(self.model, self.loaded, configuration, self.controller, self.pipeline.ledger)

    def unitree(self) -> UnitreeMessages:
        """Create a converter of a Unitree robot's messages. It raises InputError naming the fault of its ``motors``
        once there are such messages."""
        configuration = self.configuration
        return UnitreeMessages(configuration["motors"], self.robot.joint_names, self.controller, configuration.source)

    def read_robot(self, urdf: str, source: str) -> Robot:
        """Read a description with the same links and joints as this one's. Raises InputError naming the ``source``."""
        configuration = self.configuration
        return Robot(
            urdf,
            floating_base=configuration.floating_base,
            cuts=[sensor.frame for sensor in self._sensors if sensor.role == "mounted"],
            locked_joints=self.locked_joints,
            gravity=tilted_gravity(configuration.gravity, self.loaded.effects),
            source=source,
        )

    @property
    def prior(self) -> FloatArray | None:
        """Parameters ``(D,)`` of an earlier estimate to start from, NaN where it has none; None without one."""
        return self.loaded.parameters(self.model)

    @property
    def known_parameters(self) -> FloatArray:
        """Parameters ``(D,)`` of the model to start from: an earlier estimate's, or the URDF's where it has none."""
        nominal, prior = self.model.nominal_parameters, self.prior
        return nominal if prior is None else np.where(np.isnan(prior), nominal, prior)

    @property
    def lockable(self) -> tuple[str, ...]:
        """Joints that are in no message so far, as those of grippers, if all of them may count as fixed at zero.

        They may if nothing measured depends on their positions: distal to them are no joints in messages, no wrench
        sensors, and at most a tenth of the moving mass. An unknown name in a message may be that of a joint that seems
        to be missing: then nothing is locked.
        """
        robot, received = self.robot, frozenset(self.received_joints)
        absent = [joint for joint in robot.joint_names if joint not in received]
        unknown = received.difference(joint.name for joint in robot.tree.joints)
        if len(absent) == len(robot.joint_names) or unknown:
            return ()
        follow = {f.joint.name: robot.joint_names[f.master] for f in robot.mimic_joints}
        child = {joint.name: joint.child for joint in robot.tree.joints}
        locked = [joint for joint in (*robot.joint_names, *follow) if follow.get(joint, joint) in absent]
        measured = [joint for joint in (*robot.joint_names, *follow) if joint not in locked]
        distal = {link for joint in locked for link in robot.tree.subtree(child[joint])}
        if distal & {*(sensor.frame for sensor in self.model.sensors), *(child[joint] for joint in measured)}:
            return ()
        moving = {link for joint in measured for link in robot.tree.subtree(child[joint])}
        moving = set(robot.tree.links) if robot.floating_base else moving
        masses = {link: float(parameters[0]) for link, parameters in robot.tree.inertials.items() if link in moving}
        light = sum(masses[link] for link in distal & masses.keys()) <= LIGHT * sum(masses.values())
        return tuple(absent) if light else ()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics on which data are expected, by the pipeline's names."""
        base = (self.base_topic,) if self.robot.floating_base else ()
        commands = () if self.controller is None else (COMMANDS,)
        return (JOINT_STATES, *commands, *base, *(sensor.topic for sensor in self.model.sensors))

    @property
    def meaning(self) -> dict[str, Any]:
        """Everything that the rows depend on, by name, as JSON. Rows of two sessions may be added up if these agree."""
        loaded, joints = self.loaded, self.robot.joint_names
        signals = loaded.corrected_signals(SignalSettings(), joints)
        corrections = {
            "effort_gain": signals.effort_gain,
            "effort_delay": signals.effort_delay,
            "wrench_offsets": [list(sensor.offset) for sensor in self.model.sensors],
            "gravity": self.robot.gravity.tolist(),
            "effects": [[c.effect.name, c.place_name, vars(c.effect)] for c in self.model.coefficients],
        }
        urdf = hashlib.sha256(self.urdf.encode(errors="replace")).hexdigest()
        parameters = {**self.configuration.row_parameters, "locked_joints": [*self.locked_joints]}
        return {"robot_description": urdf, **parameters, "model": corrections}

    @property
    def effort_gains(self) -> FloatArray:
        """Factors ``(joints,)`` from the messages' efforts to N m (or N), including known sensor gains."""
        return self.signals.effort_gains(self.robot.joint_names)

    @property
    def signals(self) -> SignalSettings:
        """The configuration's settings, including what is known of the sensors."""
        joints = self.robot.joint_names
        return self.loaded.corrected_signals(self.configuration.signals(joints), joints)

    def new_pipeline(
        self,
        cutoff: float | None = None,
        effect_columns: tuple[Column, ...] | None = None,
        on_accepted: Callable[[AcceptedMessages], None] = ignore,
        ledger: Ledger | None = None,
    ) -> SignalPipeline:
        """Create a pipeline for another recording of the same robot.

        Args:
            cutoff: cutoff of the low-pass [Hz]; the configuration's, unless given.
            effect_columns: the columns to compute; those of the model's effects, unless given.
            on_accepted: called with every accepted message.
            ledger: counts what becomes of each message.
        """
        return SignalPipeline(
            self.model,
            replace(self.signals, cutoff=cutoff) if cutoff else self.signals,
            effect_columns=effect_columns,
            on_accepted=on_accepted,
            ledger=ledger,
            received_joints=self.received_joints,
            locked_joints=self.locked_joints,
            still_distance=self.configuration["still_distance"],
            mount=self._imu_mount,
            controller=self.controller,
        )

    @property
    def base_topic(self) -> str:
        """Topic of a floating base's motion, by the pipeline's name."""
        return IMU if self.configuration["imu.frame"] else ODOM

    @property
    def relative_mass_std(self) -> float:
        """Standard deviation of the relative error of the total mass, as which the bias of an accelerometer along
        gravity appears in one recording. Zero without an IMU."""
        gravity = float(np.linalg.norm(self.robot.gravity))
        return ACCELEROMETER_BIAS / gravity if self.base_topic == IMU else 0.0

    @property
    def _imu_mount(self) -> ImuMount | None:
        """Placement of the IMU. Raises InputError if it is not on the base."""
        frame = self.configuration["imu.frame"]
        if not frame:
            return None
        placement = naming(f"{self.configuration.source}: imu.frame", self.robot.base_placement, frame)
        return ImuMount(placement[:3, :3], placement[:3, 3], self.robot.gravity)

    @property
    def _identified_prior(self) -> FloatArray | None:
        """Prior without invalid coefficients: older files may have a negative excess of Stribeck friction."""
        if (prior := self.prior) is None:
            return None
        positive = np.array([c.positive for c in self.model.coefficients], dtype=bool)
        first = len(prior) - len(positive)
        return np.append(prior[:first], np.where(positive & (prior[first:] <= 0.0), np.nan, prior[first:]))

    def again(self, values: Mapping[str, Any] | None = None, loaded: LoadedModel | None = None) -> Session:
        """Make a session of the same robot that has read nothing, with these values of parameters, and this model."""
        return Session(self.urdf, self.configuration.with_values(values or {}), self.source, loaded=loaded)

    def reconfigure(self, configuration: Configuration) -> None:
        """Solve with another configuration of the same rows. If it does not fit, raises InputError without changes."""
        settings = self._estimator_settings(configuration)
        self.identifier.use(settings)
        self.configuration, self.settings = configuration, settings

    def _estimator_settings(self, configuration: Configuration) -> EstimatorSettings:
        """Estimator settings with the population prior. Raises InputError if several priors are given, or none fits."""
        settings = configuration.estimator([channel.name for channel in self.model.channels])
        files = {reader: ELEMENTS[reader] for reader in self._readers}
        settings = replace(settings, files=files, relative_mass_std=self.relative_mass_std)
        path = configuration["prior"]
        given = [name for name, value in (("model", self.loaded.source), ("gamma", configuration["gamma"])) if value]
        if path and given:
            raise InputError(f"{configuration.source}: prior and {given[0]} are both given; choose one")
        if path:
            return replace(settings, population=read_population(Path(path)))
        if configuration["alike"] == "urdf" and not given:
            return replace(settings, alike=alike_parts(self.model.robot, self.model.identified))
        return settings

    @property
    def notes(self) -> list[str]:
        """Remarks in sentences that do not make results doubtful."""
        return [*self.review.notes, *alike_sentences(self.settings.alike)]

    def rms(
        self,
        batches: Iterable[Samples],
        parameters: FloatArray,
        drive_gains: FloatArray | None = None,
        added: Callable[[Samples], FloatArray] | None = None,
    ) -> FloatArray:
        """RMS residual of each channel over samples at parameters ``(D,)``, ``(channels,)``, or at several ``(D, K)``,
        ``(channels, K)``; NaN where nothing was measured. ``drive_gains``: see :meth:`MeasurementModel.predict`.
        ``added`` returns further efforts ``(N, joints, K)``."""
        several = parameters.reshape(len(parameters), -1)
        gains = None if drive_gains is None else drive_gains.reshape(len(drive_gains), -1)
        squares = np.zeros((len(self.model.channels), several.shape[1]))
        counts = np.zeros((len(self.model.channels), 1))
        for samples in batches:
            measured, predicted = self.model.predict(samples, several, gains)
            if added is not None and self.model.layout.efforts:
                predicted += self.model.caused_by_efforts(samples, added(samples))
            squares += np.nansum((measured[:, :, None] - predicted) ** 2, axis=0)
            counts += np.count_nonzero(np.isfinite(measured), axis=0)[:, None]
        mean = np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0)
        return np.sqrt(mean).reshape(len(squares), *parameters.shape[1:])

    def checkpoint(self) -> Checkpoint:
        """Make a checkpoint of everything that was learned so far."""
        return Checkpoint(
            self.meaning,
            self.identifier.memory(),
            self.pipeline.ledger.topics,
            self.warm_start,
            self._solving,
            findings=self.review.findings,
            watch=self.watch,
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Resume from the rows of a checkpoint of the same meaning, and from its estimate if solved in the same way.
        The findings on these rows stay.

        Raises:
            InputError: they do not fit; nothing is changed then.
        """
        warm = checkpoint.warm
        if warm is not None and warm.parameters.shape != (self.model.dimension,):
            raise InputError(f"an estimate of {warm.parameters.size} parameters, expected {self.model.dimension}")
        self.identifier.restore(checkpoint.memory)
        self.warm_start = warm if checkpoint.solving == self._solving else None
        self.review.read_elsewhere(RecordingFacts(findings=checkpoint.findings))
        self.watch = checkpoint.watch

    @property
    def _solving(self) -> str:
        """Checksum of everything but the rows that a solve depends on."""
        prior, population = self.prior, self.settings.population
        text = f"{replace(self.settings, population=None)} {prior.tolist() if prior is not None else None}"
        if population is not None:  # its arrays would be abbreviated as text
            text += json.dumps(population_document(population))
        return hashlib.sha256(text.encode(errors="replace")).hexdigest()


def predicting_session(
    urdf: str, configuration: Configuration, source: str, loaded: LoadedModel | None = None
) -> Session:
    """Make a session that predicts with the gains of drives of its model, see :class:`Session`."""
    loaded = loaded or LoadedModel.read(configuration["model"])
    return Session(urdf, configuration, source, loaded=loaded.to_predict)


def installed_version() -> str:
    """Installed version of this package."""
    try:
        return version("geomid_ros")
    except PackageNotFoundError:
        return "not installed"


def document(
    session: Session, estimate: Estimate, held_out: FloatArray | None = None, verdict: Verdict | None = None
) -> dict[str, Any]:
    """Make the document of ``estimate.json``.

    Args:
        session: the session that found it.
        estimate: the estimate.
        held_out: RMS residual of each channel on held-out data ``(channels,)``, if there are any.
        verdict: its verdict; that of the session's review unless given.
    """
    review, effects = session.review, session.loaded.effects
    rejected = dict(session.identifier.counts.rejected)
    final = verdict or review.verdict(estimate)
    merged = {link.name: link.merged for link in estimate.links}
    return estimate_document(estimate, rejected, held_out, effects) | {
        "robot": session.robot.name,
        "verdict": verdict_entry(final, review.findings),
        "warnings": review.warnings(estimate, final),
        "notes": session.notes,
        "messages": {topic: account_entry(account) for topic, account in session.pipeline.ledger.topics.items()},
        "gravity": session.configuration.gravity.tolist(),
        "predictor": predictor_entry(session.model, estimate),
        "handover": {
            reader: handover_entry(written_model(session.model, estimate, reader, effects), merged)
            for reader in estimate.within
        },
    }


def identified_urdf(session: Session, estimate: Estimate) -> str:
    """Robot description with the inertias and friction that were fitted for a URDF; every other character is kept,
    but names of files become absolute."""
    written = written_model(session.model, estimate, URDF, session.loaded.effects)
    return with_effects(with_inertias_of(session, estimate, written), written.effects)


def with_inertias_of(session: Session, estimate: Estimate, written: WrittenModel) -> str:
    """Robot description with the inertias of an estimate's written model, and its original friction."""
    links = session.robot.as_links(written.inertias)
    shares = [name for name in links if name not in written.inertias]
    note = f"{', '.join(shares)}: {_SHARES}"
    session.review.settled += [note] if shares and note not in session.review.settled else []
    whole = with_absolute_files(session.urdf, session.robot.source)
    return with_inertials(whole, links, session.robot.included_links([link.name for link in estimate.links]))


_SHARES = (
    "behind a locked joint, and the URDF's inertial is not possible as a part of the body that was identified; in "
    "files, the body is divided in the URDF's proportions"
)


def save(
    session: Session,
    folder: Path,
    estimate: Estimate,
    held_out: FloatArray | None = None,
    verdict: Verdict | None = None,
) -> list[Path]:
    """Write ``estimate.json``, see :func:`document`, ``identified.urdf`` and ``posterior.npz`` into a folder.

    Returns their paths.
    """
    of_estimate, description = folder / "estimate.json", folder / "identified.urdf"
    write_text(description, identified_urdf(session, estimate))
    posterior = write_posterior(folder / POSTERIOR, estimate.posterior)
    write_json(of_estimate, document(session, estimate, held_out, verdict))
    return [of_estimate, description, *posterior]
