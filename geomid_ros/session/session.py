"""What the node and the command line share: from a robot description and a configuration to an identifier and back."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart, nominal_parameters
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.files.atomic import write_text
from geomid_ros.files.checkpoints.checkpoint import Checkpoint
from geomid_ros.files.models.continued_effects import continued
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.results import estimate_document, write_estimate
from geomid_ros.files.models.urdf import with_identified_inertias
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import JOINT_STATES, ODOM, Accepted
from geomid_ros.signals.pipeline import Recent, SignalPipeline, ignore
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.streams import EffectColumns
from geomid_ros.types import FloatArray


class Session:
    """A robot under identification: its model, its signal pipeline and its identifier."""

    def __init__(self, urdf: str, configuration: Configuration, source: str, ledger: Ledger | None = None) -> None:
        """``source`` names the description in messages, ``ledger`` is told what becomes of every message. Raises
        InputError for what does not fit together."""
        self.urdf = urdf
        self.configuration = configuration
        self.loaded = LoadedModel.read(configuration["model"])
        sensors = self.loaded.sensors(configuration.sensors)
        self.robot = Robot(
            urdf,
            floating_base=configuration["floating_base"],
            cuts=[sensor.frame for sensor in sensors if sensor.role == "mounted"],
            locked_joints=configuration["locked_joints"],
            gravity=self.loaded.gravity(configuration.gravity),
            source=source,
        )
        effects = configuration.effects
        local = self.loaded.local_effects([effect.name for effect in effects])
        self.model = MeasurementModel(self.robot, effects, sensors, configuration.links, local)
        self.identifier = Identifier(
            self.model,
            configuration.estimator([channel.name for channel in self.model.channels]),
            configuration.buffer,
            self.prior,
        )
        self.warm: WarmStart | None = None
        """Where the next solve may begin: the last estimate."""
        self.recent = Recent(configuration["gap.memory"])
        self.pipeline = self.new_pipeline(on_accepted=self.recent, ledger=ledger)

    @property
    def prior(self) -> FloatArray | None:
        """The parameters ``(D,)`` of an earlier estimate to start from, NaN where it has none; None without one."""
        return self.loaded.parameters(self.model)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that data are expected on, as the pipeline calls them."""
        base = (ODOM,) if self.robot.floating_base else ()
        return (JOINT_STATES, *base, *(sensor.topic for sensor in self.model.sensors))

    @property
    def meaning(self) -> dict[str, Any]:
        """What the rows mean, by name, as JSON has it: rows of two sessions that agree in it may be added up."""
        loaded, joints = self.loaded, self.robot.joint_names
        signals = loaded.signals(SignalSettings(), joints)
        corrections = {
            "effort_gain": signals.effort_gain,
            "effort_delay": signals.effort_delay,
            "wrench_offsets": [list(sensor.offset) for sensor in self.model.sensors],
            "gravity": loaded.gravity(self.configuration.gravity).tolist(),
            "effects": [[c.effect.name, c.joint_name, vars(c.effect)] for c in self.model.coefficients],
        }
        urdf = hashlib.sha256(self.urdf.encode(errors="replace")).hexdigest()
        return {"robot_description": urdf, **self.configuration.of_rows, "model": corrections}

    @property
    def nominal_parameters(self) -> FloatArray:
        """The URDF's parameters ``(D,)``: its inertias and no effects."""
        return nominal_parameters(self.model)

    def new_pipeline(
        self,
        settings: SignalSettings | None = None,
        effect_columns: EffectColumns | None = None,
        on_accepted: Callable[[Accepted], None] = ignore,
        ledger: Ledger | None = None,
    ) -> SignalPipeline:
        """A pipeline without a past, for another recording of the same robot; with the configuration's settings and the
        columns of the model's effects unless others are given."""
        joints = self.robot.joint_names
        return SignalPipeline(
            joints,
            floating_base=self.robot.floating_base,
            sensors=self.model.sensors,
            settings=self.loaded.signals(settings or self.configuration.signals(joints), joints),
            continuous=[joint.name for joint in self.robot.joints if joint.continuous],
            effect_columns=effect_columns or self.model.effect_columns,
            on_accepted=on_accepted,
            ledger=ledger,
        )

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
        """All that is known so far, to be written down."""
        return Checkpoint(self.meaning, self.identifier.memory(), self.pipeline.ledger.topics, self.warm, self._solving)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from the rows of a checkpoint of the same meaning, and from its estimate, if that was made as it would
        be made here. Raises InputError, and changes nothing, if they do not fit."""
        warm = checkpoint.warm
        if warm is not None and warm.parameters.shape != (self.model.dimension,):
            raise InputError(f"an estimate of {warm.parameters.size} parameters, expected {self.model.dimension}")
        self.identifier.restore(checkpoint.memory)
        self.warm = warm if checkpoint.solving == self._solving else None

    @property
    def _solving(self) -> str:
        """What a solve depends on beside the rows, as a checksum."""
        settings = self.configuration.estimator([channel.name for channel in self.model.channels])
        prior = self.prior
        text = f"{settings} {prior.tolist() if prior is not None else None}"
        return hashlib.sha256(text.encode(errors="replace")).hexdigest()

    def save(self, folder: Path, estimate: Estimate, held_out: FloatArray | None = None) -> Mapping[str, Any]:
        """Write ``estimate.json`` and ``identified.urdf`` into ``folder``; returns the former's document."""
        document = estimate_document(estimate, dict(self.identifier.rows_rejected), held_out)
        document |= continued(document["effects"], self.loaded.effects)
        write_text(folder / "identified.urdf", with_identified_inertias(self.urdf, estimate.links))
        write_estimate(folder / "estimate.json", document)
        return document
