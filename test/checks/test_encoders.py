"""Joints that count from another zero, the other way round, or another joint's angle, too, are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimation.arms import Case, Motion, efforts, motion, samples

from checks.test_efforts import ROBOTS, case, findings, named
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray


@pytest.fixture(params=ROBOTS, ids=str)
def robot(request: pytest.FixtureRequest) -> Case:
    return case(*request.param)


def moved(sound: Samples, joint: int, by: float | FloatArray) -> Samples:
    """The recording with something added to the positions of a joint."""
    position = sound.position.copy()
    position[:, joint] += by
    return replace(sound, position=position)


@pytest.mark.parametrize(("name", "degrees"), [("arm7", 12.0), ("arm7", -25.0), ("arm3", 90.0)])
def test_the_zero_of_a_joint_is_off(name: str, degrees: float) -> None:
    """Of the second joint, which carries weight; it is told by how much. In an arm of three joints the centres of mass
    take up a small one."""
    robot = case(name, 1)
    cause = named(robot.model, moved(robot.samples, 1, np.radians(degrees)))
    assert (cause.kind, cause.places) == ("zero", (robot.model.robot.joint_names[1],))
    told = float(cause.sentence.split("about ")[1].split()[0])
    assert told == pytest.approx(-degrees, abs=4.0)


def seen(own: Samples, position: FloatArray) -> Samples:
    """Samples with other positions, as they are read: they move by these."""
    velocity = 100.0 * np.gradient(position, axis=0)
    return replace(own, position=position, velocity=velocity, acceleration=100.0 * np.gradient(velocity, axis=0))


def test_a_position_that_stands_still_is_named(robot: Case) -> None:
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


def test_a_robot_that_stands_still_in_one_half_is_judged_by_what_moves() -> None:
    """Both parts that have to ask for a cause have as much of the motion."""
    seven = case("arm7", 1)
    own = seven.samples
    still = own.select(np.zeros(2 * len(own), dtype=np.int64))
    still = replace(
        still,
        stamps=own.stamps[0] - (own.stamps[1] - own.stamps[0]) * np.arange(len(still), 0, -1),
        velocity=np.zeros_like(still.velocity),
        acceleration=np.zeros_like(still.acceleration),
        effort=still.effort + 1e-3 * np.random.default_rng(0).normal(size=still.effort.shape),
    )
    recorded = Samples.concatenate([still, own])
    subject = EffortData.of_all(seven.model.robot, recorded)
    halves = [np.count_nonzero(part.is_moving) for part in subject.halves]
    assert halves[0] == pytest.approx(halves[1], abs=1.0)
    assert len(subject.halves[0].samples) > 2 * len(own)
    assert findings(seven.model, recorded) == ()


@pytest.mark.parametrize("name", ["arm3", "arm7"])
def test_a_joint_that_rests_again_and_again_while_others_move_is_sound(name: str) -> None:
    """Its effort, and those of the others, are those of that pose."""
    of, rng = case(name, 1), np.random.default_rng(1)
    moving = motion(rng, len(of.model.robot.joints), 20.0)
    joint = 1 % len(of.model.robot.joints)
    moves = np.clip(2.0 * np.sin(2.0 * np.pi * np.arange(len(moving)) / 500.0 + 1), 0.0, 1.0)
    velocity = moving.velocity.copy()
    velocity[:, joint] *= moves
    position, acceleration = moving.position.copy(), moving.acceleration.copy()
    position[:, joint] = position[0, joint] + np.cumsum(velocity[:, joint]) / 100.0
    acceleration[:, joint] = np.gradient(velocity[:, joint]) * 100.0
    stopping = Motion(position, velocity, acceleration)
    effort = efforts(of.model.robot, of.true, stopping)
    own = samples(stopping, effort + 0.05 * rng.normal(size=effort.shape))
    assert findings(of.model, own) == ()


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


def test_of_a_joint_that_waits_several_times_the_rubbing_of_others_says_nothing() -> None:
    """As from point to point: others rub otherwise while it waits for them."""
    of, stopping, waits = waiting(5, 0)
    effort = efforts(of.model.robot, of.true, stopping)
    effort[:, 4] += 2.0 * np.std(effort[:, 4]) * waits * np.sin(np.arange(len(waits)) / 7.0)
    assert "frozen" not in kinds(of, stopping, effort)


def test_a_joint_that_waits_under_any_effort_that_its_friction_holds_is_sound() -> None:
    """At rest friction is what the controller leaves, up to its largest."""
    of, stopping, waits = waiting(6, 0)
    effort = efforts(of.model.robot, of.true, stopping)
    dry, viscous = (of.true.effects[name][0] for name in ("coulomb_friction", "viscous_friction"))
    largest = dry + viscous * np.max(np.abs(stopping.velocity[:, 0]))
    effort[:, 0] += 0.9 * largest * waits * np.sign(np.sin(np.arange(len(waits)) / 700.0))
    noise = 0.05 * np.random.default_rng(0).normal(size=effort.shape)
    assert "frozen" not in kinds(of, stopping, effort + noise)
