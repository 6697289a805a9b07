"""The robots of the figures, from example-robot-data, and truths about them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import files
from pathlib import Path

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, estimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.excitation.belief import ROWS_PER_SECOND, Belief
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.model.samples import samples_of
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.excitation import DesignTask, design_task
from geomid_ros.session.options import MotionOptions
from geomid_ros.types import FloatArray

PACKAGE = "example-robot-data"
ROBOTS = {
    "ur5": ("ur5_robot.urdf", ""),
    "ur10": ("ur10_robot.urdf", ""),
    "panda": ("panda.urdf", "panda_finger_joint1"),
    "xarm7": ("xarm7.urdf", ""),
    "talos_arm": ("talos_left_arm.urdf", "gripper_left_joint"),
}
"""File, and the joints that stand still, by name."""
SPREAD = 0.2  # geodesic distance of true inertias from the URDF's, in each direction


@dataclass(frozen=True)
class Description:
    """A URDF's text and path, and the folder of its package."""

    text: str
    path: Path
    package: Path
    locked: tuple[str, ...]


@cache
def description(robot: str) -> Description:
    """The robot of that name."""
    name, locked = ROBOTS[robot]
    (file,) = (Path(str(f.locate())) for f in files(PACKAGE) or () if f.as_posix().endswith(f"/{name}"))
    package = next(parent for parent in file.parents if parent.name == PACKAGE)
    return Description(file.read_text(encoding="utf-8"), file, package, tuple(filter(None, [locked])))


def wish(robot: str, seconds: float, seed: int = 0, aim: str = "prediction") -> MotionOptions:
    """One period of a design for a robot."""
    packages = {PACKAGE: description(robot).package}
    return MotionOptions(duration=seconds, repeats=1, package_path=packages, seed=seed, aim=aim)


def task(robot: str, asked: MotionOptions) -> DesignTask:
    """What a search needs."""
    own = description(robot)
    configuration = Configuration({"locked_joints": list(own.locked)}, "benchmark")
    return design_task(own.text, own.path, configuration, asked)


def truth(prior: Belief, random: np.random.Generator) -> FloatArray:
    """Parameters ``(D,)``: links at geodesic distances, effects of any usual size."""
    posterior = prior.posterior
    tangent = random.standard_normal(prior.model.dimension)
    links = posterior.manifold.inertial
    tangent[links] *= SPREAD
    tangent[links.stop :] *= 0.5 * posterior.prior_stds[links.stop :]
    return np.array(posterior.manifold.exp(posterior.point, tangent).parameters)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Rows ``(N, J, D)`` of a motion at independent instants, and the efforts measured there ``(N, J)``."""

    rows: FloatArray
    measured: FloatArray


def recorded(knowledge: Belief, motion: ExcitingMotion, true: FloatArray, random: np.random.Generator) -> Recorded:
    """A motion that a robot ran, with white noise."""
    count = int(np.ceil(ROWS_PER_SECOND * motion.form.duration))
    times = (np.arange(count) + 0.5) * motion.form.duration / count
    rows = knowledge.model.rows(samples_of(motion.at(times)[:3])).coefficients
    noise = knowledge.sigmas * random.standard_normal(rows.shape[:2])
    return Recorded(rows, rows @ true + noise)


def identified(knowledge: Belief, recordings: list[Recorded]) -> Estimate:
    """The estimate from some recordings."""
    summary = RowSummary(knowledge.model.channels)
    for recording in recordings:
        summary.add(recording.rows, recording.measured)
    return estimate(knowledge.model, summary, EstimatorSettings())


def predicted_error(knowledge: Belief, parameters: FloatArray, true: FloatArray, others: list[ExcitingMotion]) -> float:
    """RMS error of the efforts on other motions, in units of the noise."""
    squares = []
    for motion in others:
        times = np.linspace(0.0, motion.form.duration, 100)
        rows = knowledge.model.rows(samples_of(motion.at(times)[:3])).coefficients
        squares.append(np.mean(((rows @ (parameters - true)) / knowledge.sigmas) ** 2))
    return float(np.sqrt(np.mean(squares)))
