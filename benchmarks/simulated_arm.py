"""Arms with a planted truth at the level of samples: rows of a few motions; links, effects and noise of each run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.signal import lfilter

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, estimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.effects import DEFAULT_EFFECTS, identified_effect, joint_of
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.simulation.description import read_description, robot_description
from geomid_ros.simulation.motion import exciting_motion
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.types import FloatArray

ROBOT = "arm7"
RATE = 50.0  # [Hz] as the pipeline makes them
SECONDS = 30.0
MOTIONS = 4  # each run has one of them
FRESH = 99  # a motion that is never fitted
NOISE = 2e-3  # standard deviation as a share of the joint's effort limit
TIME_CONSTANTS = (0.1, 0.3, 1.0)  # [s] of correlated noise, drawn for each joint
SPREAD = 0.2
UNEVEN_SPREADS = (0.05, 0.5)  # of links whose priors are not equally good, drawn for each link
# Sizes that :mod:`geomid_ros.simulation` gives effects: shares of the joint's effort limit, at its velocity limit, and
# seconds to get there.
_VISCOUS, _COULOMB, _ROTOR, _OFFSET = 0.03, 0.02, 0.002, 0.005


@dataclass(frozen=True)
class Run:
    """What is drawn in a run: its ``seed``, noise that is ``correlated`` or white, priors of ``uneven`` quality."""

    seed: int
    correlated: bool
    uneven: bool


@dataclass(frozen=True, eq=False)
class Arm:
    """A model and its rows in one motion, ``coefficients (N, channels, D)``, with the joints' limits ``(joints,)``."""

    model: MeasurementModel
    coefficients: FloatArray
    effort: FloatArray
    velocity: FloatArray

    @property
    def noise(self) -> FloatArray:
        """Standard deviations ``(channels,)`` of the measurements."""
        return NOISE * self.effort


@cache
def arm(motion: int, seconds: float = SECONDS, resting: int | None = None) -> Arm:
    """The arm in a motion of that number; the joint ``resting`` keeps its place."""
    text = robot_description(ROBOT)
    robot = Robot(text)
    limits = {joint.name: joint for joint in read_description(text).joints}
    joints = [limits[joint.name] for joint in robot.joints]
    times = np.arange(round(seconds * RATE)) / RATE
    moving = exciting_motion(times, joints, SimulationOptions(robot=ROBOT), np.random.default_rng([motion, 1]))
    if resting is not None:
        moving.position[:, resting] = joints[resting].centre
        moving.velocity[:, resting] = moving.acceleration[:, resting] = 0.0
    model = MeasurementModel(robot, [identified_effect(name) for name in DEFAULT_EFFECTS])
    none = np.zeros((len(times), 0))
    samples = Samples(
        (1e9 * times).astype(np.int64),
        moving.position,
        moving.velocity,
        moving.acceleration,
        np.zeros_like(moving.position),
        none,
        none,
        none,
        np.zeros((len(times), 0, 6)),
    )
    return Arm(
        model,
        model.rows(samples).coefficients,
        np.array([joint.effort for joint in joints]),
        np.array([joint.velocity for joint in joints]),
    )


def truth(where: Arm, run: Run) -> FloatArray:
    """The run's true parameters ``(D,)``: links at geodesic distances from the URDF's, effects as simulated."""
    rng = np.random.default_rng([run.seed, run.correlated, run.uneven, 1])
    model = where.model
    manifold = model.manifold(np.ones(len(model.coefficients) - model.positives))
    low, high = np.log(UNEVEN_SPREADS)
    spreads = np.exp(rng.uniform(low, high, manifold.links)) if run.uneven else np.full(manifold.links, SPREAD)
    tangent = np.zeros(manifold.dimension)
    tangent[manifold.inertial] = np.repeat(spreads, 10) * rng.standard_normal(10 * manifold.links)
    nominal = np.concatenate([model.nominal_inertias, np.ones(model.positives), np.zeros(len(manifold.scales))])
    true = manifold.exp(manifold.point(nominal), tangent).parameters.copy()
    true[manifold.inertial.stop :] = [
        rng.uniform(0.5, 1.5) * _usual_size(where, c.effect.name, joint_of(c.place)) for c in model.coefficients
    ]
    true[manifold.real] *= rng.choice((-1.0, 1.0), len(manifold.scales))
    return true


def _usual_size(where: Arm, effect: str, joint: int) -> float:
    effort, velocity = where.effort[joint], where.velocity[joint]
    sizes = {
        "viscous_friction": _VISCOUS * effort / velocity,
        "coulomb_friction": _COULOMB * effort,
        "rotor_inertia": _ROTOR * effort / velocity,
        "effort_offset": _OFFSET * effort,
    }
    return float(sizes[effect])


def noise(where: Arm, run: Run) -> FloatArray:
    """The run's noise ``(N, channels)``: white, or of first order with a time constant for each joint."""
    rng = np.random.default_rng([run.seed, run.correlated, run.uneven, 2])
    count, channels = where.coefficients.shape[:2]
    settling = round(10 * max(TIME_CONSTANTS) * RATE)
    result = np.empty((count, channels))
    for channel in range(channels):
        kept = np.exp(-1.0 / (RATE * rng.choice(TIME_CONSTANTS))) if run.correlated else 0.0
        driven = np.sqrt(1.0 - kept**2) * rng.standard_normal(settling + count)
        result[:, channel] = lfilter([1.0], [1.0, -kept], driven)[settling:]
    return where.noise * result


def identified(where: Arm, targets: FloatArray, gamma: float | None = None) -> Estimate:
    """The estimate from targets ``(N, channels)``."""
    summary = RowSummary(where.model.channels)
    summary.add(where.coefficients, targets)
    return estimate(where.model, summary, EstimatorSettings(gamma=gamma))
