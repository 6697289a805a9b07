"""What drawn robots mean for the torques: their spread at every joint, against that of ranges of 20 %."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.suggested_motions import instants
from geomid_ros.exports.descriptions import described_robot
from geomid_ros.exports.posterior_samples import BAND, ENOUGH, DrawnRobots
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import places_in
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

RANGE = 0.2
"""Half of the width of the ranges that drawn robots are compared with, as a share of each number."""


@dataclass(frozen=True, eq=False)
class TorqueSpread:
    """Widths of 95 % bands of efforts, root mean square over many instants of fast motion.

    Attributes:
        joints: Their names.
        units: Of their efforts.
        drawn: Of the drawn robots ``(joints,)``.
        ranges: Of robots whose links, and whose effects, are each within 20 % of the estimate, independently
            ``(joints,)``.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    drawn: FloatArray
    ranges: FloatArray

    @property
    def ratio(self) -> float:
        """How wide drawn robots are spread beside ranges, mean over the joints."""
        return float(np.mean(self.drawn / self.ranges))


def torque_spread(robots: DrawnRobots) -> TorqueSpread:
    """The spread of joint torques of drawn robots."""
    model = MeasurementModel(
        described_robot(robots.model), [], local_effects=LoadedModel.read(robots.model.source).local_effects(())
    )
    motion = instants(model, moving=True)
    estimate = _in_order(model, robots, robots.posterior.parameters[None])[0]
    drawn = _in_order(model, robots, robots.parameters[:ENOUGH])
    bands = [torque_bands(model, motion, each) for each in (drawn, within_ranges(model, estimate))]
    joints = model.robot.joints
    return TorqueSpread(
        tuple(joint.name for joint in joints),
        tuple(joint.unit for joint in joints),
        *(np.sqrt(np.mean((high - low) ** 2, axis=0)) for low, high in bands),
    )


def torque_bands(model: MeasurementModel, motion: Samples, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper ends ``(N, channels)`` of the 95 % bands of what robots with ``parameters (robots, D)`` feel at N
    instants."""
    _, efforts = model.predict(motion, parameters.T)
    low, high = np.quantile(efforts, BAND, axis=2)
    return low, high


def _in_order(model: MeasurementModel, robots: DrawnRobots, parameters: FloatArray) -> FloatArray:
    """Drawn ``parameters (N, D)`` in the order of a measurement model; links that were not drawn are the URDF's."""
    order = places_in(robots.posterior, model)
    return np.where(order >= 0, parameters[:, order], model.nominal_parameters)


def within_ranges(model: MeasurementModel, estimate: FloatArray) -> FloatArray:
    """Robots ``(N, D)`` within 20 % of the ``estimate (D,)``: a factor for each link, and one for each effect."""
    links = len(model.body_names)
    factors = np.random.default_rng(1).uniform(1.0 - RANGE, 1.0 + RANGE, (ENOUGH, links + len(model.coefficients)))
    return np.asarray(
        estimate * np.concatenate([np.repeat(factors[:, :links], 10, axis=1), factors[:, links:]], axis=1)
    )
