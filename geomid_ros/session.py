"""What the node and the command line share: from a robot description and a configuration to an identifier and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import nominal_parameters
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.files.atomic import write_text
from geomid_ros.files.configuration import Configuration
from geomid_ros.files.results import (
    estimate_document,
    known_coefficients,
    known_inertias,
    read_estimate,
    write_estimate,
)
from geomid_ros.files.urdf import with_identified_inertias
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.signals.pipeline import JOINT_STATES, ODOM, SignalPipeline
from geomid_ros.types import FloatArray


class Session:
    """A robot under identification: its model, its signal pipeline and its identifier."""

    def __init__(self, urdf: str, configuration: Configuration, source: str) -> None:
        """``source`` names the description in messages. Raises InputError for what does not fit together."""
        self.urdf = urdf
        self.configuration = configuration
        sensors = configuration.sensors
        self.robot = Robot(
            urdf,
            floating_base=configuration["floating_base"],
            cuts=[sensor.frame for sensor in sensors if sensor.role == "mounted"],
            locked_joints=configuration["locked_joints"],
            gravity=configuration.gravity,
            source=source,
        )
        self.model = MeasurementModel(self.robot, configuration.effects, sensors, configuration.links)
        self.identifier = Identifier(
            self.model,
            configuration.estimator([channel.name for channel in self.model.channels]),
            configuration.buffer,
            self._prior(configuration["model"]),
        )
        self.pipeline = self.new_pipeline()

    def _prior(self, path: str) -> FloatArray | None:
        """The parameters ``(D,)`` of an earlier estimate, NaN where it has none."""
        if not path:
            return None
        document = read_estimate(Path(path))
        known = known_inertias(document, path)
        if not known.keys() & set(self.model.body_names):
            names = f"{', '.join(known) or 'none'}; those of this robot: {', '.join(self.model.body_names)}"
            raise InputError(f"{path}: an estimate of another robot. Its links: {names}")
        inertias = [known.get(name, np.full(10, np.nan)) for name in self.model.body_names]
        return np.concatenate([*inertias, known_coefficients(document, self.model, path)])

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that data are expected on, as the pipeline calls them."""
        base = (ODOM,) if self.robot.floating_base else ()
        return (JOINT_STATES, *base, *(sensor.topic for sensor in self.model.sensors))

    @property
    def nominal_parameters(self) -> FloatArray:
        """The URDF's parameters ``(D,)``: its inertias and no effects."""
        return nominal_parameters(self.model)

    def new_pipeline(self) -> SignalPipeline:
        """A pipeline without a past, for another recording of the same robot."""
        return SignalPipeline(
            self.robot.joint_names,
            floating_base=self.robot.floating_base,
            sensors=self.model.sensors,
            settings=self.configuration.signals(self.robot.joint_names),
            continuous=[joint.name for joint in self.robot.joints if joint.continuous],
            effect_columns=self.model.effect_columns,
        )

    def advance(self) -> Samples | None:
        """Hand the samples that are ready to the identifier, and return them."""
        samples = self.pipeline.collect()
        if samples is not None:
            self.identifier.add(samples)
        return samples

    def rms(self, batches: Iterable[Samples], parameters: FloatArray) -> FloatArray:
        """RMS residual of each channel over samples at parameters ``(D,)``; NaN where nothing was measured."""
        squares = np.zeros(len(self.model.channels))
        counts = np.zeros(len(self.model.channels))
        for samples in batches:
            measured, predicted = self.model.predict(samples, parameters)
            squares += np.nansum((measured - predicted) ** 2, axis=0)
            counts += np.count_nonzero(np.isfinite(measured), axis=0)
        return np.sqrt(np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0))

    def save(self, folder: Path, estimate: Estimate, held_out: FloatArray | None = None) -> Mapping[str, Any]:
        """Write ``estimate.json`` and ``identified.urdf`` into ``folder``; returns the former's document."""
        document = estimate_document(estimate, dict(self.identifier.rows_rejected), held_out)
        write_text(folder / "identified.urdf", with_identified_inertias(self.urdf, estimate.links))
        write_estimate(folder / "estimate.json", document)
        return document
