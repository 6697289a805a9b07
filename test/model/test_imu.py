"""An IMU in place of odometry: the equations of motion hold with what it measures."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.api.robot import topics
from geomid_ros.errors import InputError
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.options import RobotOptions
from geomid_ros.types import FloatArray

from .robots import GRAVITY, Reference, random_samples, urdf, with_values
from .test_joint_rows import assert_equal

FRAME = "radar"  # is turned against the base, and beside its origin


def mounted(robot: Robot) -> ImuMount:
    """An IMU there."""
    placement = robot.base_placement(FRAME)
    return ImuMount(placement[:3, :3], placement[:3, 3], robot.gravity)


def measured(
    reference: Reference, samples: Samples, joints: tuple[str, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angular velocities, their derivatives and specific forces ``(N, 3)`` of an IMU by pinocchio."""
    found = np.empty((3, len(samples), 3))
    frame = reference.model.getFrameId(FRAME, pin.BODY)
    for index in range(len(samples)):
        velocity, acceleration = reference.motion(samples, index, joints, FRAME)
        classical = pin.getFrameClassicalAcceleration(reference.model, reference.data, frame, pin.LOCAL)
        pin.updateFramePlacements(reference.model, reference.data)
        rotation = reference.data.oMf[frame].rotation
        found[:, index] = velocity[3:], acceleration[3:], classical.linear - rotation.T @ GRAVITY
    return found[0], found[1], found[2]


def test_efforts_and_the_wrench_on_the_base_need_nothing_but_an_imu() -> None:
    """Whichever way up is said to be, and however fast the robot flies along."""
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    reference = Reference(urdf("go2.urdf"), floating_base=True)
    samples = random_samples(robot, seed=1)
    base, efforts = reference.inverse_dynamics(samples, robot.joint_names)
    up = np.random.default_rng(2).normal(size=(len(samples), 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    pose, velocity, acceleration = mounted(robot).base_motion(*measured(reference, samples, robot.joint_names), up)
    seen = with_values(samples, base_pose=pose, base_velocity=velocity, base_acceleration=acceleration)
    rows = robot.joint_effort_rows(*robot.configuration(seen), base=True)
    found = np.einsum("ncbk,bk->nc", rows, [body.parameters for body in robot.bodies])
    assert_equal(found, np.concatenate([efforts, base], axis=1))


def test_the_base_stands_as_up_says() -> None:
    """The pose turns the base's up against gravity, upside down as well."""
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    mount = mounted(robot)
    up = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [1.0, 0.0, 0.0]])
    still = np.zeros_like(up)
    pose, _, acceleration = mount.base_motion(still, still, 9.81 * up, up)
    in_base = up @ mount.rotation.T
    turned = [pin.XYZQUATToSE3(each).rotation @ vector for each, vector in zip(pose, in_base, strict=True)]
    np.testing.assert_allclose(turned, np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "message"), [("rada", "unknown link 'rada'"), ("FL_foot", "moves relative to the base")]
)
def test_an_imu_is_on_the_base(frame: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Robot(urdf("go2.urdf"), floating_base=True).base_placement(frame)


@pytest.mark.parametrize("text", ["", "/imu", "/imu:", ":trunk", "/imu:trunk:0.1"])
def test_another_form_of_an_imu_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="TOPIC:FRAME"):
        topics(RobotOptions(imu=text))
