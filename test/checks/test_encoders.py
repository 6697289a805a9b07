"""Joints that count from another zero, the other way round, or another joint's angle, too, are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import Case

from checks.test_efforts import ROBOTS, case, findings, named
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray


@pytest.fixture(params=ROBOTS, ids=str)
def robot(request: pytest.FixtureRequest) -> Case:
    return case(*request.param)


def moved(sound: Samples, joint: int, by: float | FloatArray) -> Samples:
    """The recording with something added to the positions of a joint."""
    position = sound.position.copy()
    position[:, joint] += by
    return replace(sound, position=position)


@pytest.mark.parametrize(
    ("name", "degrees"), [("arm7", 12.0), ("arm7", -25.0), ("arm7", 90.0), ("arm3", 90.0), ("arm3", -90.0)]
)
def test_the_zero_of_a_joint_is_off(name: str, degrees: float) -> None:
    """Of the second joint, which carries weight; it is told by how much. In an arm of three joints the centres of mass
    take up a small one."""
    robot = case(name, 1)
    cause = named(robot.model, moved(robot.samples, 1, np.radians(degrees)))
    assert (cause.kind, cause.places) == ("zero", (robot.model.robot.joint_names[1],))
    told = float(cause.sentence.split("about ")[1].split()[0])
    assert told == pytest.approx(-degrees, abs=4.0)


def test_a_joint_turns_the_other_way_round(robot: Case) -> None:
    own = robot.samples
    signs = np.ones(own.effort.shape[1])
    signs[1] = -1.0
    turned = {name: signs * getattr(own, name) for name in ("position", "velocity", "acceleration", "effort")}
    cause = named(robot.model, replace(own, **turned))
    assert (cause.kind, cause.places) == ("axis", (robot.model.robot.joint_names[1],))


def test_a_position_holds_that_of_another_joint() -> None:
    sound = case("arm3", 1)
    names = sound.model.robot.joint_names
    (carrier,) = sound.model.robot.parallel_joints(2)
    own = sound.samples
    both = {}
    for name in ("position", "velocity", "acceleration"):
        both[name] = getattr(own, name).copy()
        both[name][:, 2] += both[name][:, carrier]
    cause = named(sound.model, replace(own, **both))
    assert (cause.kind, cause.places) == ("absolute", (names[2], names[carrier]))


@pytest.mark.parametrize("degrees", [0.5, 1.0])
def test_of_a_zero_that_is_hardly_off_nothing_is_said(robot: Case, degrees: float) -> None:
    assert findings(robot.model, moved(robot.samples, 1, np.radians(degrees))) == ()


def test_a_position_that_stands_still_is_named(robot: Case) -> None:
    own = robot.samples
    middle = slice(round(0.4 * len(own)), round(0.6 * len(own)))
    frozen = own.position.copy()
    frozen[middle, 1] = frozen[middle.start, 1]
    cause = named(robot.model, replace(own, position=frozen))
    assert (cause.kind, cause.places) == ("frozen", (robot.model.robot.joint_names[1],))
