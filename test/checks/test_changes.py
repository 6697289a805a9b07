"""What changes during a recording is named with its time; robots that warm up, or stand for a while, are sound."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimation.arms import ALL_EFFECTS, Case, Motion, Truth, arm, efforts, motion, samples
from scipy.signal import filtfilt, firwin

from checks import test_efforts
from checks.test_efforts import checked
from geomid_ros.checks.candidates import MASS_FACTOR
from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

SECONDS, CHANGE = 24.0, 9.0
ROBOTS = [("arm3", 11), ("arm7", 12)]


def findings(of: Case, recorded: Samples) -> tuple[RecordingFault, ...]:
    return checked(of.model, recorded).findings()


def named(of: Case, recorded: Samples) -> Cause:
    """The one cause that is named."""
    return test_efforts.named(of.model, recorded)


CHANGES = {"offset", "drift", "switched", "load", "slip"}


def changed(of: Case, recorded: Samples, kind: str) -> Cause:
    """A change that is named at the right time, perhaps with others that are like it to three joints."""
    (finding,) = findings(of, recorded)
    assert finding.sure, finding
    causes = {cause.kind: cause for cause in (finding.cause, *finding.rivals)}
    assert kind in causes
    assert causes.keys() <= CHANGES
    assert len(causes) == 1 or len(of.model.robot.joints) == 3
    cause = causes[kind]
    (time,) = re.findall(r"about (\d+) s", cause.sentence)
    assert abs(float(time) - CHANGE) < 0.1 * SECONDS
    return cause


@cache
def case(name: str, seed: int) -> Case:
    return arm(name, seed, seconds=SECONDS)


@pytest.fixture(params=ROBOTS[:1], ids=str)
def robot(request: pytest.FixtureRequest) -> Case:
    """The small arm, unless a test says another one."""
    return case(*request.param)


def later(of: Case) -> FloatArray:
    """Whether something has changed by then ``(N, 1)``."""
    return np.asarray(of.samples.seconds >= CHANGE)[:, None]


def loaded(true: Truth, mass: float) -> Truth:
    """The same robot with a ball on its last link."""
    links = true.links.copy()
    links[-1] += mass * np.array([1.0, 0.0, 0.0, 0.1, 0.012, 0.0, 0.012, 0.0, 0.0, 0.002])
    return replace(true, links=links)


def felt(of: Case, true: Truth, gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)) -> FloatArray:
    """What the joints of such a robot feel, measured with noise."""
    feels = efforts(of.model.robot, true, of.samples, gravity)  # type: ignore[arg-type]  # it has the motion's names
    return np.asarray(feels + 0.05 * np.random.default_rng(3).normal(size=feels.shape))


@pytest.mark.parametrize(("robot", "joint"), [(ROBOTS[0], 0), (ROBOTS[1], 1)], indirect=["robot"])
def test_a_sensor_is_set_to_zero(robot: Case, joint: int) -> None:
    effort = robot.samples.effort.copy()
    effort[:, joint] -= later(robot)[:, 0] * np.std(effort[:, joint])
    cause = changed(robot, replace(robot.samples, effort=effort), "offset")
    assert cause.places == (robot.model.robot.joint_names[joint],)
    (size,) = re.findall(r"by (-[\d.]+) N m", cause.sentence)
    assert float(size) == pytest.approx(-np.std(robot.samples.effort[:, joint]), rel=0.3)


@pytest.mark.parametrize(("robot", "at_first"), [(ROBOTS[0], True), (ROBOTS[1], False)], indirect=["robot"])
def test_gravity_is_compensated_for_a_part_of_the_time(robot: Case, at_first: bool) -> None:
    whole, without = felt(robot, robot.true), felt(robot, robot.true, (0.0, 0.0, 0.0))
    effort = np.where(later(robot) != at_first, without, whole)
    assert "gravity" in changed(robot, replace(robot.samples, effort=effort), "switched").sentence


@pytest.mark.parametrize(("robot", "mass"), [(ROBOTS[0], 1.0), (ROBOTS[1], -1.0)], indirect=["robot"])
def test_something_is_taken_up_or_put_down(robot: Case, mass: float) -> None:
    heavy = loaded(robot.true, 1.0)
    first, second = (robot.true, heavy) if mass > 0.0 else (heavy, robot.true)
    effort = np.where(later(robot), felt(robot, second), felt(robot, first))
    cause = changed(robot, replace(robot.samples, effort=effort), "load")
    (size, way) = re.findall(r"carries about ([\d.]+) kg (more|less)", cause.sentence)[0]
    assert way == ("more" if mass > 0.0 else "less")
    assert float(size) == pytest.approx(1.0, rel=0.5)


def test_the_bag_in_which_something_changes_is_named(robot: Case) -> None:
    """The second one was recorded an hour later."""
    heavy = felt(robot, loaded(robot.true, 1.0))
    recorded = replace(robot.samples, effort=np.where(later(robot), heavy, felt(robot, robot.true)))
    border = int(np.argmax(later(robot)))
    check = RecordingCheck(CheckTask(robot.model, np.ones(len(robot.model.robot.joints)), {}))
    for bag, pause, part in (("bare", 0, slice(border)), ("carrying", 3600 * 10**9, slice(border, None))):
        check.begin_recording(bag)
        samples = recorded.select(part)
        check.add(replace(samples, stamps=samples.stamps + pause))
    (finding,) = check.findings()
    assert re.search("from about 0 s of 'carrying' on", finding.sentence), finding


def test_what_is_on_a_robot_in_another_recording_only_is_the_reason_of_the_verdict(robot: Case) -> None:
    """Each recording is sound by itself, and the estimate explains the one to which it was fitted."""
    session = Session(robot.model.robot.urdf, Configuration({}), "arm3")
    (bare, carrying), checks = (felt(robot, robot.true), felt(robot, loaded(robot.true, 2.0))), []
    recorded = [replace(robot.samples, effort=effort) for effort in (bare, carrying, bare)]
    for bag, part in zip(("bare", "carrying", "bare again"), recorded, strict=True):
        checks.append(session.review.new_check() if checks else session.review.check)
        checks[-1].begin_recording(bag)
        checks[-1].add(part)
        assert checks[-1].findings() == ()
    assert checks[0].changes_until(checks[2]) == ()
    session.identifier.add(recorded[0])
    estimate = session.identifier.solve()
    session.review.judge_validation("carrying", checks[1], {})
    held_out = session.rms([recorded[1]], *estimate.predictor)
    judged = session.review.verdict(estimate, [recorded[1]], held_out)
    assert "carries about 2 kg more from about 0 s of 'carrying' on" in " ".join((*judged.reasons, *judged.warnings))
    assert not any("sign" in reason for reason in judged.reasons)


def test_friction_that_holds_joints_at_rest_is_not_predicted_far_worse(robot: Case) -> None:
    session = Session(robot.model.robot.urdf, Configuration({}), "arm3")
    session.identifier.add(robot.samples)
    estimate = session.identifier.solve()
    rests = np.abs(robot.samples.velocity) < 0.04 * np.max(np.abs(robot.samples.velocity), axis=0)
    holding = replace(robot.samples, effort=robot.samples.effort + np.where(rests, 2.0, 0.0))
    held_out = session.rms([holding], *estimate.predictor)
    assert np.min(held_out / estimate.rms) > MASS_FACTOR
    assert "far worse" not in " ".join(session.review.verdict(estimate, [holding], held_out).warnings)


@pytest.mark.parametrize("robot", ROBOTS[1:], indirect=["robot"], ids=str)
def test_all_efforts_change_by_a_factor(robot: Case) -> None:
    effort = np.where(later(robot), 0.6, 1.0) * robot.samples.effort
    cause = changed(robot, replace(robot.samples, effort=effort), "drift")
    (factor,) = re.findall(r"([\d.]+) times the earlier value", cause.sentence)
    assert float(factor) == pytest.approx(0.6, abs=0.1)


def test_a_coupling_slips(robot: Case) -> None:
    share = robot.samples.seconds / SECONDS
    position = robot.samples.position.copy()
    position[:, 1] += np.radians(15.0) * share
    cause = named(robot, replace(robot.samples, position=position))
    assert (cause.kind, cause.places) == ("slip", (robot.model.robot.joint_names[1],))
    (size,) = re.findall(r"by \+(\d+) degrees", cause.sentence)
    assert float(size) == pytest.approx(15.0, abs=3.0)


def test_an_effort_is_frozen_for_a_while(robot: Case) -> None:
    effort = robot.samples.effort.copy()
    effort[700:1500, 1] = effort[700, 1]
    first, *_ = findings(robot, replace(robot.samples, effort=effort))
    assert (first.cause.kind, first.cause.places) == ("constant", (robot.model.robot.joint_names[1],))
    assert "from about 7 s to 15 s" in first.cause.sentence


def test_an_effort_in_coarse_steps_is_not_frozen(robot: Case) -> None:
    """What gravity and motion ask for between two steps is not seen."""
    steps, moves = 2.5 * np.std(robot.samples.effort, axis=0), np.sin(0.8 * robot.samples.seconds) > 0.0
    noise = 0.3 * moves[:, None] * np.random.default_rng(0).normal(size=robot.samples.effort.shape)
    levels = np.round((robot.samples.effort - np.mean(robot.samples.effort, axis=0)) / steps + noise + 0.5)
    seen = filtfilt(firwin(41, 5.0, fs=100.0), 1.0, steps * levels, axis=0)
    assert not [f for f in findings(robot, replace(robot.samples, effort=seen)) if f.cause.kind == "constant"]


def test_efforts_of_the_urdf_itself_are_remarked_on(robot: Case) -> None:
    """A simulation of it may be meant, so it is no doubt; a real robot has friction."""
    urdf = Truth(np.array([body.parameters for body in robot.model.robot.bodies]), {})
    for true, remarks in ((urdf, 1), (robot.true, 0)):
        check = RecordingCheck(CheckTask(robot.model, np.ones(len(robot.model.robot.joints)), {}))
        feels = efforts(robot.model.robot, true, robot.samples)  # type: ignore[arg-type]  # it has the motion's names
        check.add(replace(robot.samples, effort=feels))
        assert check.findings() == ()
        assert len(check.remarks) == remarks


@pytest.mark.parametrize("robot", ROBOTS[1:], indirect=["robot"], ids=str)
def test_friction_that_warms_up_is_no_fault(robot: Case) -> None:
    """By a fifth, as oil does."""
    cold = dict(robot.true.effects)
    cold["viscous_friction"] = cold["coulomb_friction"] = np.zeros_like(cold["viscous_friction"])
    rigid = felt(robot, replace(robot.true, effects=cold))
    friction = felt(robot, robot.true) - rigid
    warmth = (1.0 - 0.2 * robot.samples.seconds / SECONDS)[:, None]
    assert findings(robot, replace(robot.samples, effort=rigid + warmth * friction)) == ()


def test_a_robot_that_stands_at_first_is_no_fault() -> None:
    """Stiction holds what it likes, also while somebody leans on the robot now and then."""
    rng = np.random.default_rng(1)
    of = arm("arm3", 1, seconds=SECONDS)
    moving = motion(rng, 3, SECONDS)
    still = np.mean(moving.position, axis=0) * np.ones((700, 1))  # amid all other poses
    stands = samples(
        replace(
            moving,
            position=np.concatenate([still, moving.position]),
            velocity=np.concatenate([0.0 * still, moving.velocity]),
            acceleration=np.concatenate([0.0 * still, moving.acceleration]),
        ),
        np.zeros((700 + len(moving), 3)),
    )
    measured = felt(replace(of, samples=stands), of.true)
    measured[:700] += 1.5 * np.sign(rng.normal(size=3)) * np.maximum(of.true.effects["coulomb_friction"], 1.0)
    measured[:700] *= 1.0 + np.sin(np.arange(700) / 100.0)[:, None]
    assert set(of.true.effects) == set(ALL_EFFECTS)
    assert findings(of, replace(stands, effort=measured)) == ()


@pytest.mark.parametrize(
    ("robot", "factor", "place"),
    [(ROBOTS[0], 0.05, 0.5), (ROBOTS[0], -1.0, 0.8), (ROBOTS[1], -30.0, 0.25)],
    indirect=["robot"],
)
def test_efforts_in_another_unit_from_some_instant_on(robot: Case, factor: float, place: float) -> None:
    effort = robot.samples.effort.copy()
    effort[round(place * len(effort)) :] *= factor
    (finding,) = findings(robot, replace(robot.samples, effort=effort))
    assert (finding.cause.kind, finding.sure, finding.rivals) == ("stream", True, ())
    said = re.search(r"from about (\d+) s", finding.sentence)
    assert said is not None
    assert float(said[1]) == pytest.approx(place * SECONDS, abs=0.06 * SECONDS)


BRISK = 2.0
LATE = 10  # messages, of 10 ms


def moving(of: Case, speed: float, noise: float) -> Case:
    """A robot in a motion, so many times as fast as usual; noise in N m."""
    slow = motion(np.random.default_rng(5), len(of.model.robot.joints), speed * 24.0, 100.0 / speed)
    fast = Motion(slow.position, speed * slow.velocity, speed**2 * slow.acceleration)
    noiseless = efforts(of.model.robot, of.true, fast)
    measured = noiseless + noise * np.random.default_rng(6).normal(size=noiseless.shape)
    return replace(of, samples=samples(fast, measured), noiseless=noiseless)


@pytest.fixture(params=ROBOTS[:1], ids=str)
def brisk(request: pytest.FixtureRequest) -> Case:
    """A robot in a brisk motion: a slow one is about the same a little later."""
    return moving(case(*request.param), BRISK, 0.05)


def with_lags(of: Case, late: list[int]) -> Samples:
    """The efforts of each joint, so many messages late or early."""
    whole = of.samples
    inside = np.arange(20, len(whole) - 20)
    effort = np.column_stack([whole.effort[inside - lag, joint] for joint, lag in enumerate(late)])
    return replace(whole.select(inside), effort=effort)


@pytest.mark.parametrize(("brisk", "late"), [(ROBOTS[0], LATE), (ROBOTS[1], -LATE)], indirect=["brisk"])
def test_all_efforts_are_late_or_early(brisk: Case, late: int) -> None:
    cause = named(brisk, with_lags(brisk, [late] * len(brisk.model.robot.joints)))
    assert cause.kind == "late"
    (time, how) = re.findall(r"all are about (\d+) ms (late|early)", cause.sentence)[0]
    assert how == ("late" if late > 0 else "early")
    assert float(time) == pytest.approx(10.0 * LATE, rel=0.4)


def dry(of: Case, late: int = 0) -> FloatArray:
    """Dry friction that is most of the efforts, and turns about so many messages late."""
    own = of.samples
    return 2.0 * np.std(own.effort, axis=0) * np.tanh(np.roll(own.velocity, late, axis=0) / 0.02)


def test_all_that_joints_feel_is_late(brisk: Case) -> None:
    """Where friction is most of the efforts, and the lag half as long."""
    rubbed = replace(brisk, samples=replace(brisk.samples, effort=brisk.samples.effort + dry(brisk)))
    cause = named(brisk, with_lags(rubbed, [LATE // 2] * len(brisk.model.robot.joints)))
    assert cause.kind == "late"
    assert float(re.findall(r"all are about (\d+) ms late", cause.sentence)[0]) == pytest.approx(50.0, rel=0.2)


def test_friction_that_turns_late_is_no_lag(brisk: Case) -> None:
    own = brisk.samples
    assert findings(brisk, replace(own, effort=own.effort + dry(brisk, LATE // 2))) == ()


def test_the_efforts_of_one_joint_are_late(brisk: Case) -> None:
    lags = [0] * len(brisk.model.robot.joints)
    lags[1] = LATE
    cause = named(brisk, with_lags(brisk, lags))
    assert (cause.kind, cause.places) == ("late", (brisk.model.robot.joint_names[1],))


def test_a_lag_that_hardly_matters_is_passed_over(brisk: Case) -> None:
    assert findings(brisk, with_lags(brisk, [1] * len(brisk.model.robot.joints))) == ()
