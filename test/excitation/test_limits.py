"""Limits: those that are given, those that follow, and those that are missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.excitation.limits import JointLimits, motion_limits
from geomid_ros.files.parameter_file import read_joint_limits
from geomid_ros.model.robot import Robot

from .arm import urdf

JOINTS = ("j1", "j2", "j3")


def limits(given: dict[str, JointLimits] | None = None, text: str = urdf()):
    robot = Robot(text)
    return motion_limits(robot, given or {}, np.array([body.parameters for body in robot.bodies]), 0.5, "small.urdf")


def test_given_limits_win_and_others_follow_and_are_said() -> None:
    found = limits({"j1": JointLimits(velocity=1.0, acceleration=3.0), "j2": JointLimits(jerk=7.0, lower=-0.5)})
    assert np.allclose(found.velocity, [0.5, 1.0, 1.0])
    assert found.acceleration[0] == 3.0
    assert np.allclose(found.jerk, [30.0, 7.0, 10.0 * found.acceleration[2]])
    assert found.position[1].tolist() == [-0.5, 2.5]
    assert np.all(np.isinf(limits(text=urdf('<limit effort="60" velocity="2"/>')).position[2])), "no range, no limit"
    said = " ".join(found.notes)
    assert "j2 " in found.notes[0]
    assert "j1 " not in found.notes[0]
    assert "jerk limits are 10 1/s times" in said


def test_an_effort_suffices_for_the_acceleration_that_follows_from_it() -> None:
    """By Newton and Euler: in any posture, accelerating one joint as hard as that takes no more than its limit."""
    heavy = urdf().replace('mass value="1.0"', 'mass value="6.0"')
    found, robot = limits(text=heavy), Robot(heavy)
    inertias = np.array([body.parameters for body in robot.bodies])
    q = robot.pinocchio_positions(np.random.default_rng(5).uniform(-2.5, 2.5, (50, 3)))
    for joint, hard in enumerate(found.acceleration):
        acceleration = np.tile(hard * np.eye(3)[joint], (50, 1))
        effort = robot.joint_effort_rows(q, np.zeros((50, 3)), acceleration)[:, joint]
        assert np.all(np.abs(np.einsum("nbk,bk->n", effort, inertias)) <= found.effort[joint] * 1.05)
    assert np.any(found.acceleration < 10.0 * 2.0)


@pytest.mark.parametrize(
    ("limit", "kind", "message"),
    [
        ("", "continuous", "has no velocity limit; give it a velocity in its <limit>, or has_velocity_limits"),
        ('<limit effort="0" velocity="2" lower="-1" upper="1"/>', "revolute", "has no acceleration limit"),
        ('<limit effort="9" lower="-1" upper="1"/>', "revolute", 'its <limit> has effort="9", no velocity;'),
    ],
)
def test_missing_limits_are_named(limit: str, kind: str, message: str) -> None:
    with pytest.raises(InputError, match=f"joint 'j3'.* {message}"):
        limits(text=urdf(limit, kind))


def test_a_file_gives_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "joint_limits.yaml"
    path.write_text(
        "joint_limits:\n  j3: {has_velocity_limits: true, max_velocity: 2.5, has_acceleration_limits: true, "
        "max_acceleration: 4.0, has_jerk_limits: false, max_jerk: 1.0}\n  other: {}\n"
    )
    given = read_joint_limits(path, JOINTS)
    assert given == {"j3": JointLimits(velocity=2.5, acceleration=4.0)}
    assert limits(given, urdf("", "continuous")).velocity[2] == 1.25


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "has no 'joint_limits' by joint"),
        ("joint_limits: {nobody: {}}", "joint 'nobody'"),
        ("joint_limits: {j1: {max_velocity: -1}}", "joint 'j1': max_velocity is -1"),
        ("joint_limits: {j1: {has_jerk_limits: true}}", "has_jerk_limits is true and max_jerk is absent"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "joint_limits.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_joint_limits(path, JOINTS)
