"""Whether a motion fits a robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS

from excitation.motions import BUMP, Motion, bump
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.excitation.watch import RobotLimits, check_motion
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


def test_a_motion_within_all_limits_is_taken(tmp_path: Path) -> None:
    check_motion(points(bump(LIMITS.joints, 4.0), tmp_path), LIMITS, "m.yaml")


def test_what_goes_too_far_or_too_fast_is_refused(tmp_path: Path) -> None:
    far = float(LIMITS.upper[0]) + 0.01 - 0.2
    with pytest.raises(InputError, match=r"m.yaml: joint 'joint3' moves from 0.200 to .* outside its range"):
        check_motion(points(bump(LIMITS.joints, 9.0, far), tmp_path), LIMITS, "m.yaml")
    low = float(LIMITS.lower[0]) - 0.01 - 0.2
    with pytest.raises(InputError, match=r"joint 'joint3' moves from .* to 0.200, outside its range"):
        check_motion(points(bump(LIMITS.joints, 9.0, low), tmp_path), LIMITS, "m.yaml")
    fastest = np.abs(BUMP.deriv()(np.linspace(0.0, 1.0, 60))).max()
    duration = 0.5 * float(fastest) / float(LIMITS.speeds[0])
    check_motion(points(bump(LIMITS.joints, 1.01 * duration), tmp_path), LIMITS, "m.yaml")
    with pytest.raises(InputError, match=r"joint 'joint3' moves at .* lower --speed"):
        check_motion(points(bump(LIMITS.joints, 0.99 * duration), tmp_path), LIMITS, "m.yaml")


@pytest.mark.parametrize(("row", "word"), [(0, "begins"), (-1, "ends")])
def test_a_motion_that_is_not_at_rest_at_its_ends_is_refused(row: int, word: str, tmp_path: Path) -> None:
    motion = points(bump(LIMITS.joints, 4.0), tmp_path)
    velocities = motion.velocities.copy()
    velocities[row, 1] = 0.3
    moving = Trajectory(motion.joints, motion.times, motion.positions, velocities, motion.accelerations)
    with pytest.raises(InputError, match=f"the motion {word} at 0.3 .* of joint 'joint1'"):
        check_motion(moving, LIMITS, "m.yaml")
