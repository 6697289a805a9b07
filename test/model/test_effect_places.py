"""Where effects are looked for that nobody said are there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot

from .robots import urdf

COUPLED = identifiable()["coupled_viscous_friction"]


def pairs(name: str, *, asked_for: bool = False) -> set[str]:
    """Places of a motor that turns two joints, the joints by the ends of their names."""
    effects = {"effects": [COUPLED]} if asked_for else {"effects": [], "candidates": [COUPLED]}
    model = MeasurementModel(Robot(urdf(name)), **effects)  # type: ignore[arg-type]
    return {coefficient.place_name for coefficient in model.coefficients}


@pytest.mark.parametrize(
    ("name", "meeting"),
    [
        # The other axes of its arm are parallel.
        (
            "ur5_robot.urdf",
            {"shoulder_pan_joint+shoulder_lift_joint", "wrist_1_joint+wrist_2_joint", "wrist_2_joint+wrist_3_joint"},
        ),
        # Its elbow and its flange are beside the axes before them.
        (
            "panda.urdf",
            {"panda_joint1+panda_joint2", "panda_joint2+panda_joint3", "panda_joint5+panda_joint6"},
        ),
    ],
)
def test_a_motor_of_two_joints_is_looked_for_where_axes_meet(name: str, meeting: set[str]) -> None:
    assert pairs(name) == meeting


def test_a_motor_of_two_joints_is_at_all_that_follow_one_another_where_it_is_asked_for() -> None:
    joints = Robot(urdf("ur5_robot.urdf")).joint_names
    assert pairs("ur5_robot.urdf", asked_for=True) == {f"{a}+{b}" for a, b in pairwise(joints)}


@pytest.mark.parametrize("name", ["ur5_robot.urdf", "panda.urdf", "kinova.urdf"])
def test_axes_meet_where_some_point_of_both_is_the_same(name: str) -> None:
    """Of points along both axes, at a posture of which meeting does not depend."""
    robot, model = Robot(urdf(name)), pin.buildModelFromXML(urdf(name))
    data = model.createData()
    pin.forwardKinematics(model, data, pin.randomConfiguration(model))
    for first, joint in enumerate(robot.joint_names[:5]):
        lines = []
        for one in (joint, robot.joint_names[first + 1]):
            index = model.getJointId(one)
            letter = model.joints[index].shortname()[-1]  # of the axis that it turns about
            lines.append((data.oMi[index].translation, data.oMi[index].rotation[:, "XYZ".index(letter)]))
        (point, axis), (other, other_axis) = lines
        plane = np.stack([axis, -other_axis], axis=1)
        along = np.linalg.lstsq(plane, other - point, rcond=None)[0]
        gap = np.linalg.norm(plane @ along - (other - point))
        crossing = np.linalg.norm(np.cross(axis, other_axis)) > 0.1
        assert robot.axes_meet(first, first + 1) == bool(crossing and gap < 1e-3)
