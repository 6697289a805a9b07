"""Whether a motion fits a robot.

The way to the start, and the way to rest.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS
from scipy.interpolate import CubicHermiteSpline

from excitation.motions import BUMP, Motion, bump
from geomid_ros.errors import InputError
from geomid_ros.excitation.approach import stopping_accelerations, stopping_trajectory, trajectory_through
from geomid_ros.excitation.limits import RobotLimits, check_motion
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.trajectories import read_trajectory
from geomid_ros.model.robot import Robot

ROBOT = Robot((BAGS / "arm3.urdf").read_text(), source="arm3.urdf")
LIMITS = RobotLimits.of(ROBOT, ("joint3", "joint1"), "motion.yaml")


def points(motion: Motion, folder: Path) -> Trajectory:
    return read_trajectory(motion.write(folder / "trajectory.yaml", 60))


def test_limits_are_the_urdfs_in_the_order_of_the_motion() -> None:
    text = (BAGS / "arm3.urdf").read_text()
    for place, joint in enumerate(LIMITS.joints):
        limit = text.partition(f'<joint name="{joint}"')[2].partition("<limit ")[2].partition("/>")[0]
        values = dict(item.replace('"', "").split("=") for item in limit.split())
        found = LIMITS.lower[place], LIMITS.upper[place], LIMITS.speeds[place], LIMITS.efforts[place]
        assert found == tuple(float(values[key]) for key in ("lower", "upper", "velocity", "effort"))
    with pytest.raises(InputError, match=r"motion.yaml: .* another robot: unknown joint of arm3.urdf 'joint9'"):
        RobotLimits.of(ROBOT, ("joint9",), "motion.yaml")


def test_what_goes_too_far_or_too_fast_is_refused(tmp_path: Path) -> None:
    fastest = np.abs(BUMP.deriv()(np.linspace(0.0, 1.0, 60))).max()
    duration = 0.5 * float(fastest) / float(LIMITS.speeds[0])
    check_motion(points(bump(LIMITS.joints, 1.01 * duration), tmp_path), LIMITS, "m.yaml")
    for motion, said in (
        (bump(LIMITS.joints, 0.99 * duration), "joint 'joint3' moves at .* lower --speed"),
        (bump(LIMITS.joints, 9.0, LIMITS.upper[0] - 0.19), "joint 'joint3' moves from 0.200 to .* outside its range"),
        (bump(LIMITS.joints, 9.0, LIMITS.lower[0] - 0.21), "joint 'joint3' moves from .* to 0.200, outside its range"),
    ):
        with pytest.raises(InputError, match=f"m.yaml: {said}"):
            check_motion(points(motion, tmp_path), LIMITS, "m.yaml")


@pytest.mark.parametrize(("row", "word"), [(0, "begins"), (-1, "ends")])
def test_a_motion_that_is_not_at_rest_at_its_ends_is_refused(row: int, word: str, tmp_path: Path) -> None:
    motion = points(bump(LIMITS.joints, 4.0), tmp_path)
    velocities = motion.velocities.copy()
    velocities[row, 1] = 0.3
    with pytest.raises(InputError, match=f"the motion {word} at 0.3 .* of joint 'joint1'"):
        check_motion(replace(motion, velocities=velocities), LIMITS, "m.yaml")


JOINTS = ("a", "b", "c")


@pytest.mark.parametrize("first", [0.5, 9.0])
def test_the_way_to_the_start_is_slow_and_at_rest_at_both_ends(first: float) -> None:
    random = np.random.default_rng(1)
    here, there = random.uniform(-3.0, 3.0, (2, 3))
    limits = np.array([first, 3.0, np.inf])
    way = trajectory_through(JOINTS, [here, there], limits)
    np.testing.assert_allclose(way.positions[[0, -1]], [here, there])
    np.testing.assert_allclose(way.velocities[[0, -1]], 0.0, atol=1e-12)
    np.testing.assert_allclose(way.accelerations[[0, -1]], 0.0, atol=1e-12)
    times = np.linspace(0.0, way.duration, 4001)
    positions, velocities = np.moveaxis([way.at(time) for time in times.tolist()], 1, 0)
    np.testing.assert_allclose(velocities, np.gradient(positions, times, axis=0), atol=1e-3)
    fastest = np.abs(velocities).max(axis=0)
    slow = np.array([0.05 if first < 1.0 else 0.25, 0.25, 0.25])
    assert np.all(fastest <= slow * (1.0 + 1e-6))
    assert np.max(fastest / slow) == pytest.approx(1.0, rel=1e-3), "it takes no longer than it must"
    assert np.all(np.diff(positions, axis=0) * (there - here) >= -1e-12), "it goes straight there"


def test_the_way_to_rest_decelerates_uniformly() -> None:
    """By the cubic that a controller makes of where it is and the one point."""
    random = np.random.default_rng(1)
    position, velocity = random.normal(0.0, 1.0, (2, 3))
    most = np.array([1.0, 4.0, 9.0])
    way = stopping_trajectory(JOINTS, position, velocity, most)
    assert way.accelerations.shape == (1, 0), "else it is no cubic"
    end = way.positions[0]
    np.testing.assert_array_equal(way.velocities, 0.0)
    path = CubicHermiteSpline([0.0, way.duration], [position, end], [velocity, np.zeros(3)])
    slowing = path(np.linspace(0.0, way.duration, 50), 2)
    np.testing.assert_allclose(slowing, np.broadcast_to(-velocity / way.duration, slowing.shape), atol=1e-9)
    assert np.all(np.abs(velocity / way.duration) <= most + 1e-12)
    assert way.duration <= max(0.5, float(np.max(np.abs(velocity) / most))) + 1e-12


def test_a_joint_stops_as_hard_as_it_moves_and_from_its_limit_in_half_a_second() -> None:
    motion = trajectory_through(JOINTS, [np.zeros(3), np.array([0.1, 0.1, 0.1])], np.full(3, 2.0)).at_speed(4.0)
    own = np.abs(motion.accelerations).max()
    found = stopping_accelerations(motion, np.array([0.01, 3.0, np.inf]))
    np.testing.assert_allclose(found, [own, 6.0, own])
    assert stopping_trajectory(JOINTS, np.zeros(3), np.array([0.0, -3.0, 0.0]), found).duration == pytest.approx(0.5)
