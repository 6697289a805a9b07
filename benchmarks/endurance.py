"""An adapting body under random tracking errors, step after step: is it possible after each? See
:mod:`benchmarks.adaptation`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.feedforward import described
from geomid_ros.api.feedforward import robot_to_move
from geomid_ros.control.correction import SHORTEST, Adaptation, removed_fraction
from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.model.samples import ACCELERATION_PER_SPEED, SAMPLES_PER_PIECE, random_states
from geomid_ros.session.options import FillOptions
from geomid_ros.simulation.description import robot_description

_STEP = 2e-3  # [s]
_FASTEST = np.pi  # [rad/s]
_SIZES = (-2.0, 8.0)  # decades of errors, in hundredths of the effort limits: up to a million times the limits


@dataclass(frozen=True)
class Endured:
    """So many ``steps``, of which so many ``moved`` the body, and after which it was ``impossible`` so often; the
    ``least`` ratio of its pseudo-inertia's smallest eigenvalue to the largest."""

    steps: int
    moved: int
    impossible: int
    least: float


def endure(name: str, seconds: float, heaviest: float, folder: Path) -> Endured:
    """Let the last body of a robot adapt at 500 Hz for so many simulated seconds, to errors of every size at random
    states. Nothing that switches the correction off stands before it."""
    session = robot_to_move(FillOptions(robot_description(described(name, folder))), None)
    robot, rng = session.robot, np.random.default_rng(0)
    efforts = MotorEfforts(
        session.model, session.known_parameters, session.effort_gains, robot.joint_names, "the motion"
    )
    rows_of, identified = efforts.of_body(robot.body_names[-1])
    adaptation, noise = Adaptation(identified, heaviest), 0.01 * efforts.limits[:, None]
    share, fastest = removed_fraction(_STEP, SHORTEST), np.full(len(robot.joints), _FASTEST)
    steps, moved, impossible, least = round(seconds / _STEP), 0, 0, np.inf
    for begin in range(0, steps, SAMPLES_PER_PIECE):
        count = min(SAMPLES_PER_PIECE, steps - begin)
        states = random_states(rng, count, robot.position_limits, fastest, ACCELERATION_PER_SPEED * fastest)
        sizes = 10.0 ** rng.uniform(*_SIZES, (count, 1))
        for motion, errors in zip(states.swapaxes(0, 1), sizes * rng.normal(size=(count, len(fastest))), strict=True):
            before = adaptation.point
            adaptation.step(share * adaptation.shortest_change(rows_of(motion) / noise, errors))
            smallest, *_, largest = np.linalg.eigvalsh(adaptation.point.pseudo_inertias[0])
            moved += adaptation.point is not before
            impossible += not smallest > 0.0
            least = min(least, float(smallest / largest))
    return Endured(steps, moved, impossible, least)
