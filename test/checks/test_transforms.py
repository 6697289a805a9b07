"""Units of positions, clocks and gravity are named; what only a part of a recording shows is a remark."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimation.arms import Case, Motion, efforts, motion, samples

from benchmarks.corruption.__main__ import judged
from benchmarks.corruption.recording import ARM3, Recording
from benchmarks.corruption.simulated import RAIL, simulated
from checks.test_efforts import ROBOTS, case, checked, findings, named
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session
from geomid_ros.types import BoolArray, FloatArray


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


@pytest.mark.parametrize("robot", ROBOTS[:2], indirect=True)
def test_noise_of_accelerations_is_told_with_what_a_fit_loses_by_it(robot: Case) -> None:
    """A fit of inertial efforts to those of noisy accelerations is too small by that; with half the cutoff nothing is
    lost that could be seen."""
    own, joints = robot.samples, robot.model.robot.joint_names
    noises = np.random.default_rng(5).normal(size=(2, *own.acceleration.shape)) * np.std(own.acceleration)
    weightless, still = robot.model.robot.with_gravity(np.zeros(3)), np.zeros_like(own.velocity)
    noisy = own.acceleration + noises[0]
    true, from_noisy = (weightless.joint_efforts(own.position, still, values) for values in (own.acceleration, noisy))
    cause = named(robot.model, replace(own, acceleration=noisy, acceleration_noise=noises[1]))
    assert cause.kind == "noise"
    lost = 1.0 - np.sum(true * from_noisy, axis=0) / np.sum(from_noisy**2, axis=0)
    told = [lost[joints.index(place)] for place in cause.places]
    (said,) = re.findall(r"(\d+)%", cause.sentence)
    assert float(said) == pytest.approx(100.0 * max(told), rel=0.35)  # from some hundred instants
    half = 0.5**2.5  # noise of second derivatives behind a low-pass
    softer = replace(own, acceleration=own.acceleration + half * noises[0], acceleration_noise=half * noises[1])
    assert "noise" not in [finding.cause.kind for finding in findings(robot.model, softer)]


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


@pytest.mark.parametrize(("name", "degrees"), [("arm7", 12.0), ("arm3", 90.0)])
def test_the_zero_of_a_joint_is_off(name: str, degrees: float) -> None:
    """Of the second joint, which carries weight; it is told by how much. In an arm of three joints the centres of mass
    take up a small one."""
    robot = case(name, 1)
    position = robot.samples.position + np.radians(degrees) * (np.arange(len(robot.model.robot.joints)) == 1)
    cause = named(robot.model, replace(robot.samples, position=position))
    assert (cause.kind, cause.places) == ("zero", (robot.model.robot.joint_names[1],))
    told = float(cause.sentence.split("about ")[1].split()[0])
    assert told == pytest.approx(-degrees, abs=4.0)


def seen(own: Samples, position: FloatArray) -> Samples:
    """Samples with other positions, as they are read: they move by these."""
    velocity = 100.0 * np.gradient(position, axis=0)
    return replace(own, position=position, velocity=velocity, acceleration=100.0 * np.gradient(velocity, axis=0))


def test_a_position_that_stands_still_is_named() -> None:
    robot = case("arm3", 1)
    own = robot.samples
    middle = slice(round(0.4 * len(own)), round(0.6 * len(own)))
    frozen = own.position.copy()
    frozen[middle, 1] = frozen[middle.start, 1]
    cause = named(robot.model, seen(own, frozen))
    assert (cause.kind, cause.places) == ("frozen", (robot.model.robot.joint_names[1],))


def test_a_position_that_stops_at_an_end_again_and_again_is_named() -> None:
    """Each stop is short; a joint that stops with its effort is none."""
    seven = case("arm7", 1)
    own, position = seven.samples, seven.samples.position.copy()
    position[:, 2] = np.minimum(position[:, 2], np.quantile(position[:, 2], 0.8))
    cause = named(seven.model, seen(own, position))
    assert (cause.kind, cause.places) == ("frozen", (seven.model.robot.joint_names[2],))


def waiting(seed: int, joint: int) -> tuple[Case, Motion, BoolArray]:
    """An arm of which a joint stands exactly still, three times in ten, while the others move; and when it does."""
    of, moving = case("arm7", 1), motion(np.random.default_rng(seed), 7, 20.0)
    waits = np.arange(len(moving)) % 500 < 150
    held = np.maximum.accumulate(np.where(waits, 0, np.arange(len(moving))))
    position, velocity, acceleration = moving.position.copy(), moving.velocity.copy(), moving.acceleration.copy()
    position[:, joint] = position[held, joint]
    velocity[waits, joint] = acceleration[waits, joint] = 0.0
    return of, Motion(position, velocity, acceleration), waits


def kinds(of: Case, stopping: Motion, effort: FloatArray) -> list[str]:
    """The causes that are named."""
    return [finding.cause.kind for finding in findings(of.model, samples(stopping, effort))]


def test_a_joint_that_waits_under_any_effort_that_its_friction_holds_is_sound() -> None:
    """At rest friction is what the controller leaves, up to its largest."""
    of, stopping, waits = waiting(6, 0)
    effort = efforts(of.model.robot, of.true, stopping)
    dry, viscous = (of.true.effects[name][0] for name in ("coulomb_friction", "viscous_friction"))
    largest = dry + viscous * np.max(np.abs(stopping.velocity[:, 0]))
    effort[:, 0] += 0.9 * largest * waits * np.sign(np.sin(np.arange(len(waits)) / 700.0))
    noise = 0.05 * np.random.default_rng(0).normal(size=effort.shape)
    assert "frozen" not in kinds(of, stopping, effort + noise)
