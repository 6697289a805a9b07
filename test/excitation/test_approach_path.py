"""The way to the start: free where distances are looked at densely, around what is in between, or refused."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from excitation.arm import urdf
from excitation.motions import bump
from geomid_ros.errors import InputError
from geomid_ros.excitation.approach import ApproachPath
from geomid_ros.files.trajectories import read_trajectory
from geomid_ros.model.collision import CollisionModel
from geomid_ros.model.robot import Robot
from geomid_ros.session.excitation import collision_model
from geomid_ros.session.options import Surroundings
from geomid_ros.types import FloatArray

CLEARANCE = 0.02
JOINTS = ("j3", "j1", "j2")  # in another order than the robot's
HERE, THERE = np.array([0.3, -0.8, 1.2]), np.array([0.3, 0.8, 1.2])
PILLAR = "box:0.6,0,0.6,0.1,0.1,0.8"  # in front, between the two


def robot(text: str | None = None) -> Robot:
    return Robot(text or urdf(), source="small.urdf")


def passage(*avoid: str, standing: tuple[float, ...] = (0.0, 0.0, 0.0)) -> tuple[ApproachPath, CollisionModel]:
    collision = collision_model(Surroundings(avoid=avoid), robot(), Path("small.urdf"))
    assert collision is not None
    found = ApproachPath(robot(), JOINTS, np.array(standing), collision)
    found.require_clearance(np.array([HERE, THERE]), CLEARANCE)
    return found, collision


def least_distance(collision: CollisionModel, postures: list[FloatArray]) -> float:
    """On straight ways, of postures in the order of JOINTS, by many instants."""
    shares = np.linspace(0.0, 1.0, 2000)[:, None]
    path = np.vstack([one + shares * (other - one) for one, other in pairwise(postures)])
    return float(np.min(collision.distances(path[:, [1, 2, 0]])))


def test_a_way_is_straight_or_leads_around_what_is_in_between() -> None:
    free, _ = passage("box:0,2,0,0.1,0.1,0.1")
    (only,) = free.find_postures(HERE, THERE)
    np.testing.assert_array_equal(only, THERE)
    found, collision = passage(PILLAR)
    assert least_distance(collision, [HERE, THERE]) < 0.0
    between, end = found.find_postures(HERE, THERE)
    np.testing.assert_array_equal(end, THERE)
    assert least_distance(collision, [HERE, between, end]) >= CLEARANCE - 1e-9
    low, high = robot().position_limits[[2, 0, 1]].T
    assert np.all((low <= between) & (between <= high))


def test_a_robot_that_is_enclosed_is_not_moved() -> None:
    walls = "box:0.6,0,0.6,1,0.02,1.6", "box:-0.6,0,0.6,1,0.02,1.6"
    found, _ = passage(*walls, "plane:0,0,-1,-1.2")
    with pytest.raises(InputError, match=r"no collision-free approach to the start: \w+ and box:0.6.* collide; move"):
        found.find_postures(HERE, THERE)


def test_who_is_close_to_something_may_leave_it_and_not_come_closer() -> None:
    """The arm stands upright, 5 mm beside a wall, and turns away from it, or into it."""
    wall = "box:0.085,0,1.1,0.1,1,0.6"  # its face is at 0.035, that of the arm at 0.03
    upright, away, into = np.zeros(3), np.array([0.0, 0.0, -0.8]), np.array([0.0, 0.0, 0.02])
    for end, free in ((away, True), (into, False)):
        found, collision = passage(wall)
        assert 0.004 < np.min(collision.distances(np.zeros((1, 3)))) < 0.006
        found.require_clearance(upright[None], CLEARANCE)
        assert (found._obstacle(upright, end) == "") == free


def test_joints_that_stand_elsewhere_count() -> None:
    """With the second joint bent forwards, the third one, which alone moves, meets the box in front."""
    for bend, free in ((0.0, True), (1.2, False)):
        collision = collision_model(Surroundings(avoid=("box:0.6,0,0.55,0.1,0.6,0.1",)), robot(), Path("small.urdf"))
        found = ApproachPath(robot(), ("j3",), np.array([0.0, bend, 9.0]), collision)
        ends = np.array([[-1.5], [1.5]])
        found.require_clearance(ends, CLEARANCE)
        if free:
            assert len(found.find_postures(*ends)) == 1
        else:
            with pytest.raises(InputError, match="no collision-free approach to the start: fore and box"):
                found.find_postures(*ends)


def test_postures_that_gravity_forbids_are_not_passed() -> None:
    """Both ends hang; stretched to the side the second joint bears more than its limit, which is just below that."""
    weak = urdf().replace('effort="60"', 'effort="9"')
    found = ApproachPath(robot(weak), ("j2",), np.zeros(3))
    found.require_clearance(np.array([[0.0], [1.6]]), CLEARANCE)
    with pytest.raises(InputError, match=r"gravity requires 1\d\d% of the effort limit of joint 'j2'"):
        found.find_postures(np.zeros(1), np.array([1.6]))
    strong = ApproachPath(robot(), ("j2",), np.zeros(3))
    assert len(strong.find_postures(np.zeros(1), np.array([1.6]))) == 1


def test_a_motion_that_comes_too_close_is_refused(tmp_path: Path) -> None:
    motion = read_trajectory(bump(JOINTS, 4.0, 0.4, 0.0).write(tmp_path / "trajectory.yaml", 100))
    found, _ = passage()
    found.require_clearance(motion.positions[:1], CLEARANCE)
    found.check(motion, "m.yaml")
    met, _ = passage("box:0.35,0.1,1.2,0.1,0.3,0.3")
    met.require_clearance(motion.positions[:1], CLEARANCE)
    with pytest.raises(InputError, match=r"m.yaml: fore and box.* \d\.\d\d s after the motion's start"):
        met.check(motion, "m.yaml")
