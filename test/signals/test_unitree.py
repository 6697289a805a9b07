"""Unitree's messages stand for those that everything else reads."""

from typing import Any

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.controller import PDController
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, message_type, message_types, parse
from geomid_ros.signals.unitree import LOW_CMD, LOW_STATE, UnitreeMessages

from .unitree import low_cmd, low_state

PACKAGES = ["unitree_go", "unitree_hg"]
MOTORS = ["knee", "spare", "a much longer hip"]
JOINTS = ["a much longer hip", "knee"]
TIME = 1_700_000_000_123_456_789
STATE = np.array([[0.5, -0.25, 3.0], [9.0, 9.0, 9.0], [1.5, 2.0, -4.0]])
GYROSCOPE, ACCELEROMETER = np.array([0.5, 1.0, -2.0]), np.array([0.25, -0.5, 9.75])


def messages(controller: PDController | None = None) -> UnitreeMessages:
    return UnitreeMessages(MOTORS, JOINTS, controller, "go2.yaml")


def read(topic: str, data: bytes) -> Any:
    return parse(topic, message_types().deserialize_cdr(data, message_type(topic)))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_state_is_joint_states_and_an_imu_at_the_time_at_which_it_came(package: str) -> None:
    data = low_state(STATE, GYROSCOPE, ACCELEROMETER, package)
    found = messages().translated(f"{package}/msg/LowState", TIME, data)
    joints, imu = (read(topic, found[topic]) for topic in (JOINT_STATES, IMU))
    assert (joints.stamp, imu.stamp) == (TIME, TIME)
    assert joints.names == tuple(MOTORS)
    np.testing.assert_array_equal(joints.arrays, STATE.T)
    (numbers,) = imu.arrays
    np.testing.assert_array_equal(numbers[13:16], GYROSCOPE)
    np.testing.assert_array_equal(numbers[25:28], ACCELEROMETER)
    assert numbers[4] == -1.0, "its orientation is not known"


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("kp", [20.0, 35.0])
def test_set_points_mean_the_efforts_of_the_gains_that_come_with_them(kp: float, package: str) -> None:
    """Where the motors were last, with the controller's own gains: the hip's come with the command, the knee's are the
    known ones, and its set-points stay as they are."""
    controller = PDController(np.array([20.0, 50.0]), np.array([0.5, 1.0]))
    own = messages(controller)
    own.translated(f"{package}/msg/LowState", TIME, low_state(STATE, GYROSCOPE, ACCELEROMETER, package))
    knee, hip = np.array([0.75, 0.0, 1.0, 50.0, 1.0]), np.array([1.25, 3.0, 0.5, kp, 0.5])
    commanded = own.translated(f"{package}/msg/LowCmd", TIME + 5, low_cmd([knee, knee, hip], package))
    found = read(COMMANDS, commanded[COMMANDS])
    assert (found.stamp, found.names) == (TIME + 5, tuple(MOTORS))
    commands = np.array(found.arrays)[:, [2, 0]]
    efforts = controller.efforts(commands[None], STATE[[2, 0], 0], STATE[[2, 0], 1])[0]
    expected = [kp * (1.25 - 1.5) + 0.5 * (3.0 - 2.0) + 0.5, 50.0 * (0.75 - 0.5) + 1.0 * 0.25 + 1.0]
    np.testing.assert_allclose(efforts, expected, rtol=1e-12)
    np.testing.assert_array_equal(commands[:, 1], knee[:3])


def test_a_command_before_any_state_is_left_out() -> None:
    assert messages().translated(LOW_CMD, TIME, low_cmd([np.zeros(5)])) == {}


@pytest.mark.parametrize("motors", [[], ["knee"], [*JOINTS, *JOINTS], [*JOINTS, *map(str, range(20))]])
def test_motors_that_no_robot_has_are_refused(motors: list[str]) -> None:
    own = UnitreeMessages(motors, JOINTS, None, "go2.yaml")
    with pytest.raises(InputError, match=r"go2\.yaml: motors: expected .* 'a much longer hip' once among them"):
        own.translated(LOW_STATE, TIME, low_state(STATE, GYROSCOPE, ACCELEROMETER))


@pytest.mark.parametrize("package", PACKAGES)
def test_bytes_of_another_form_are_refused(package: str) -> None:
    data = low_state(STATE, GYROSCOPE, ACCELEROMETER, package)
    with pytest.raises(ValueError, match=f"{len(data) - 1} bytes, expected {len(data)}"):
        messages().translated(f"{package}/msg/LowState", TIME, data[:-1])


def test_a_time_that_no_stamp_can_be_costs_the_message() -> None:
    data = low_state(STATE, GYROSCOPE, ACCELEROMETER)
    refused: list[int] = []
    batch = [("/lowstate", time, LOW_STATE, data) for time in (TIME, 2**63)]
    origins, raw = messages().read(batch, {"/lowstate": [JOINT_STATES]}, lambda place, _: refused.append(place))
    assert (refused, origins[0]) == ([1], 0)
    assert read(JOINT_STATES, raw[0][1]).stamp == TIME
