"""Units of positions, clocks and gravity are named; what only a part of a recording shows is a remark."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimation.arms import Case, Motion, efforts, motion, samples

from benchmarks.corruption.__main__ import judged
from benchmarks.corruption.recording import ARM3, Recording
from benchmarks.corruption.simulated import RAIL, simulated
from checks.test_efforts import ROBOTS, case, checked, findings, named
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.effort_data import moving as is_sliding
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck
from geomid_ros.checks.transforms import TIMES, _times
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import REST_SPEED
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session


@pytest.fixture
def robot(request: pytest.FixtureRequest) -> Case:
    return case(*request.param)


def test_a_robot_that_is_guided_by_hand_is_told() -> None:
    """Its motors hold it: they do not feel who moves it."""
    seven = case("arm7", 2)
    still = np.zeros_like(seven.samples.velocity)
    held = efforts(seven.model.robot, replace(seven.true, effects={}), Motion(seven.samples.position, still, still))
    noise = 0.05 * np.random.default_rng(3).normal(size=held.shape)
    (finding,) = findings(seven.model, replace(seven.samples, effort=held + noise))
    assert (finding.cause.kind, finding.rivals) == ("guided", ())


@pytest.mark.parametrize(("robot", "size"), [(ROBOTS[0], 0.0), (ROBOTS[1], 9810.0)], indirect=["robot"])
def test_gravity_is_in_another_unit(robot: Case, size: float) -> None:
    model = robot.model.with_gravity(np.array([0.0, 0.0, -size]))
    cause = named(model, robot.samples)
    assert cause.kind == "gravity"
    assert cause.settings["gravity"] == pytest.approx([0.0, 0.0, -9.81], abs=1.5)


def test_a_slide_in_millimetres_is_not_taken_for_lengths_of_the_urdf(tmp_path: Path) -> None:
    """A slide that is said to be hundreds of metres out makes no URDF long."""
    sound = simulated(RAIL, 0)
    scales = np.where(np.arange(sound.position.shape[1]) == 4, 1000.0, 1.0)
    assert sound.velocity is not None
    wrong = replace(sound, position=scales * sound.position, velocity=scales * sound.velocity)
    (finding,) = judged(wrong, wrong.write(tmp_path / "bag")).review.findings
    assert (finding.cause.kind, finding.cause.places) == ("position", (sound.robot.joint_names[4],))


@pytest.mark.parametrize("rate", TIMES)
def test_joints_stick_at_the_same_samples_whatever_the_clock(rate: float) -> None:
    """Otherwise a slow robot is explained better by stamps that make it slower: samples that stick have more noise."""
    velocity = 0.1 * motion(np.random.default_rng(1), 3, 10.0).velocity
    assert np.array_equal(is_sliding(rate * velocity), is_sliding(velocity))


def test_the_unit_of_a_joint_that_no_link_loads_is_open() -> None:
    """One of two crossed slides stands still, with noise for its effort."""
    robot = Robot(
        '<robot name="slides"><link name="base"/>'
        + "".join(
            f'<link name="{child}"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
            f'iyz="0"/></inertial></link><joint name="{child}_slide" type="prismatic"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/><limit lower="-9" upper="9" effort="50" velocity="9"/></joint>'
            for parent, child, axis in (("base", "x", "1 0 0"), ("x", "y", "0 1 0"))
        )
        + "</robot>"
    )
    moved = motion(np.random.default_rng(1), 2, 10.0)
    moves = np.array([0.0, 1.0])
    still = Motion(moves * moved.position, moves * moved.velocity, moves * moved.acceleration)
    measured = 2.0 * still.acceleration + 0.1 * np.random.default_rng(2).normal(size=still.position.shape)
    assert findings(MeasurementModel(robot, ()), samples(still, measured)) == ()


def test_no_clock_is_tried_under_which_the_robot_would_rest() -> None:
    """Efforts of any unit would be those of a robot that only holds itself."""
    of = case(*ROBOTS[0])
    fastest = np.max(np.abs(of.samples.velocity))
    for speed in (1e-3, 0.1, 1e9):
        slow = replace(of.samples, velocity=speed / fastest * of.samples.velocity)
        tried = list(_times(EffortData.of_all(of.model.robot, slow)))
        assert len(tried) == 1 + sum(rate * speed > REST_SPEED for rate in TIMES), "that of a guided robot, and these"


def test_what_one_of_two_recordings_shows_is_a_remark() -> None:
    """The other one, of the same robot in another motion, contradicts it."""
    robot = case(*ROBOTS[0])
    own = robot.model.robot
    moving = motion(np.random.default_rng(70), len(own.joints), 10.0)
    sound = samples(moving, efforts(own, robot.true, moving))
    wrong = replace(robot.samples, effort=np.where(np.arange(len(own.joints)) == 1, -1.0, 1.0) * robot.samples.effort)
    check = RecordingCheck(CheckTask(robot.model, np.ones(len(own.joints)), {}))
    for bag, recorded in (("wrong", wrong), ("sound", sound)):
        check.begin_recording(bag)
        check.add(recorded)
    assert all(finding.cause.kind != "sign" for finding in check.findings())
    assert checked(robot.model, wrong).findings() != ()


def test_what_is_wrong_with_a_bag_that_is_judged_on_is_a_remark(tmp_path: Path) -> None:
    sound = Recording.read(ARM3)
    wrong = replace(sound, effort=-sound.effort).write(tmp_path / "reversed")
    session = Session(sound.urdf, Configuration({}), "arm3.urdf")
    read_bags(session, Bags(fitted=[ARM3.bag], validate=[wrong]), lambda _: None)
    assert session.review.findings == ()
    (remark,) = session.review.remarks
    assert remark.startswith("reversed (validation bag): the efforts of all joints are reversed")
    alone = Session(sound.urdf, Configuration({}), "arm3.urdf")
    read_bags(alone, Bags(fitted=[wrong]), lambda _: None)
    assert [finding.cause.kind for finding in alone.review.findings] == ["sign"]


@pytest.mark.parametrize("gain", [1.0, 0.1])
def test_friction_of_a_motor_that_turns_two_joints_is_no_coupling_of_their_efforts(gain: float) -> None:
    """The robot has it in every recording; another unit is named all the same."""
    seven = case("arm7", 2)
    shaft, effort = seven.samples.velocity[:, 5:] @ [1.0, 1.0], seven.samples.effort.copy()
    effort[:, 5:] += 2.0 * np.max(np.std(effort[:, 5:], axis=0)) * np.tanh(shaft / 0.01)[:, None]
    said = findings(seven.model, replace(seven.samples, effort=gain * effort))
    assert [finding.cause.kind for finding in said] == ([] if gain == 1.0 else ["gain"])
