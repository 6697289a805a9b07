"""Efforts that come late or early against the motion are named; friction that turns about late by itself is no lag."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import Case, Motion, efforts, motion, samples

from checks.test_changes import case, felt, findings, named
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

ROBOTS = [("arm3", 11), ("arm7", 12)]
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
def robot(request: pytest.FixtureRequest) -> Case:
    """A robot in a brisk motion: a slow one is about the same a little later."""
    return moving(case(*request.param), BRISK, 0.05)


def with_lags(of: Case, late: list[int]) -> Samples:
    """The efforts of each joint, so many messages late or early."""
    whole = of.samples
    inside = np.arange(20, len(whole) - 20)
    effort = np.column_stack([whole.effort[inside - lag, joint] for joint, lag in enumerate(late)])
    return replace(whole.select(inside), effort=effort)


@pytest.mark.parametrize(("robot", "late"), [(ROBOTS[0], LATE), (ROBOTS[1], -LATE)], indirect=["robot"])
def test_all_efforts_are_late_or_early(robot: Case, late: int) -> None:
    cause = named(robot, with_lags(robot, [late] * len(robot.model.robot.joints)))
    assert cause.kind == "late"
    (time, how) = re.findall(r"all are about (\d+) ms (late|early)", cause.sentence)[0]
    assert how == ("late" if late > 0 else "early")
    assert float(time) == pytest.approx(10.0 * LATE, rel=0.4)


def test_a_lag_is_told_by_any_residual_however_small() -> None:
    """Errors of links leave some, too, but are not late."""
    slow = moving(case(*ROBOTS[0]), 1.0, 0.01)
    assert named(slow, with_lags(slow, [4] * len(slow.model.robot.joints))).kind == "late"


def dry(of: Case, late: int = 0) -> FloatArray:
    """Dry friction that is most of the efforts, and turns about so many messages late."""
    own = of.samples
    return 2.0 * np.std(own.effort, axis=0) * np.tanh(np.roll(own.velocity, late, axis=0) / 0.02)


def test_all_that_joints_feel_is_late(robot: Case) -> None:
    """Where friction is most of the efforts, and the lag half as long."""
    rubbed = replace(robot, samples=replace(robot.samples, effort=robot.samples.effort + dry(robot)))
    cause = named(robot, with_lags(rubbed, [LATE // 2] * len(robot.model.robot.joints)))
    assert cause.kind == "late"
    assert float(re.findall(r"all are about (\d+) ms late", cause.sentence)[0]) == pytest.approx(50.0, rel=0.2)


def test_friction_that_turns_late_is_no_lag(robot: Case) -> None:
    own = robot.samples
    assert findings(robot, replace(own, effort=own.effort + dry(robot, LATE // 2))) == ()


def test_the_efforts_of_one_joint_are_late(robot: Case) -> None:
    lags = [0] * len(robot.model.robot.joints)
    lags[1] = LATE
    cause = named(robot, with_lags(robot, lags))
    assert (cause.kind, cause.places) == ("late", (robot.model.robot.joint_names[1],))


def test_a_lag_that_hardly_matters_is_passed_over(robot: Case) -> None:
    assert findings(robot, with_lags(robot, [1] * len(robot.model.robot.joints))) == ()


def test_friction_of_another_law_is_no_lag(robot: Case) -> None:
    """It is larger as a joint begins to move, and larger under load."""
    own, load = robot.samples, felt(robot, robot.true)
    friction = robot.true.effects["coulomb_friction"] * np.tanh(own.velocity / 0.02)
    friction *= 0.5 * np.exp(-((own.velocity / 0.1) ** 2)) + 0.1 * np.abs(load) / np.std(load, axis=0)
    assert findings(robot, replace(own, effort=own.effort + friction)) == ()
