"""A case: a robot, what changes in it, and two recordings, all from a seed."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from benchmarks.blind.case import robot_file
from geomid_ros.simulation.description import Description, read_description, robot_description
from geomid_ros.simulation.options import LINK_MASS, Hidden, SimulationOptions

CHANGES = (
    "payload",
    "coulomb_friction",
    "spring",
    "gravity_tilt",
    "rotor_inertia",
    "load_friction",
    "effort_gain",
    "viscous_friction",
    "effort_delay",
    LINK_MASS,
)
"""What can change; they take turns from seed to seed."""

ROBOTS = ("arm7", "arm3", "ur5_joint_limited_robot.urdf")
_RANGE = (3.3, 9.0)  # times the floor; the sizes are found to a tenth


@dataclass(frozen=True)
class RealisticCase:
    """A recording of the robot as it ``was``, and one with the ``change``, drawn to be ``target`` times the floor."""

    seed: int
    was: SimulationOptions
    change: Hidden
    target: float

    @property
    def now(self) -> SimulationOptions:
        """The recording with the change, a motion of its own."""
        return replace(self.was, motion_seed=200_000 + self.seed, hide=(self.change,))

    def scaled(self, factor: float) -> RealisticCase:
        """The same with a change ``factor`` times as large."""
        return replace(self, change=scaled(self.change, factor))

    def slower(self) -> RealisticCase:
        """The same with calmer motions."""
        return replace(self, was=replace(self.was, motion_speed=0.7 * self.was.motion_speed))

    def document(self) -> dict[str, Any]:
        """Everything that decides the recordings, for JSON."""
        return asdict(self)


def draw(seed: int) -> RealisticCase:
    """The case of a seed."""
    rng = np.random.default_rng([seed, 12])
    rate = float(rng.choice([125.0, 250.0, 500.0]))
    was = SimulationOptions(
        robot=str(rng.choice(ROBOTS)),
        seed=seed,
        motion_seed=100_000 + seed,
        realistic=True,
        duration=30.0,
        rate=rate,
        hide=(),
        motion=str(rng.choice(["sines", "aperiodic", "points"], p=[0.4, 0.4, 0.2])),
        motion_period=round(rng.uniform(5.0, 8.0) * rate) / rate,
        motion_harmonics=int(rng.integers(5, 11)),
        motion_range=rng.uniform(0.5, 0.8),
        motion_speed=rng.uniform(0.4, 0.7),
    )
    robot = read_description(robot_description(robot_file(was.robot)))
    target = float(np.exp(rng.uniform(*np.log(_RANGE))))
    return RealisticCase(seed, was, _change(CHANGES[seed % len(CHANGES)], robot, rng), target)


def _change(effect: str, robot: Description, rng: np.random.Generator) -> Hidden:
    """Of usual size, which is scaled afterwards."""
    joint = robot.joints[int(rng.integers(len(robot.joints)))]
    links = [body.name for body in robot.inertias if robot.moved_by(body.name)]
    link = str(rng.choice(links[len(links) // 2 :]))
    slowness, sign = joint.effort / joint.velocity, float(rng.choice([-1.0, 1.0]))
    turn, rest = rng.uniform(0.0, 2.0 * math.pi), joint.centre + rng.uniform(-0.5, 0.5) * joint.half_range
    places = {
        "payload": (link, _box(rng)),
        "gravity_tilt": ("", {"tilt_x": 0.02 * math.cos(turn), "tilt_y": 0.02 * math.sin(turn)}),
        "spring": (joint.name, {"stiffness": 0.05 * joint.effort / joint.half_range, "equilibrium": rest}),
        "coulomb_friction": (joint.name, {"level": 0.02 * joint.effort}),
        "viscous_friction": (joint.name, {"coefficient": 0.02 * slowness}),
        "rotor_inertia": (joint.name, {"inertia": 2e-3 * slowness}),
        "load_friction": (joint.name, {"coefficient": 0.05}),
        "effort_gain": (joint.name, {"gain": 1.0 + 0.1 * sign}),
        "effort_delay": ("", {"delay": 0.005 * sign}),
        LINK_MASS: (link, {"factor": 1.0 + 0.1 * sign}),
    }
    place, parameters = places[effect]
    return Hidden(effect, place, None, parameters)


def _box(rng: np.random.Generator) -> dict[str, float]:
    """Of one kilogram, between a dice and a brick, off the link's origin."""
    x, y, z = rng.uniform(-0.08, 0.08, 3).tolist()
    a, b, c = (rng.uniform(0.04, 0.12, 3) ** 2).tolist()
    inertia = {"ixx": (b + c) / 12.0, "iyy": (a + c) / 12.0, "izz": (a + b) / 12.0, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    return {"mass": 1.0, "com_x": x, "com_y": y, "com_z": z, **inertia}


_FIXED = ("equilibrium", "com_x", "com_y", "com_z")
_ABOUT_ONE = ("gain", "factor")


def scaled(change: Hidden, factor: float) -> Hidden:
    """A change that is ``factor`` times as large; a gain and a link's factor stay above a fifth."""
    parameters = {
        name: value
        if name in _FIXED
        else max(1.0 + factor * (value - 1.0), 0.2)
        if name in _ABOUT_ONE
        else factor * value
        for name, value in change.parameters.items()
    }
    return replace(change, parameters=parameters)
