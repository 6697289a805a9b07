"""Planted faults of efforts are named with what mends them; sound recordings are not doubted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from estimation.arms import Case, Motion, arm, efforts, motion, samples, shipped, truth

from geomid_ros.checks.causes import NOT_CHECKED, Cause, RecordingFault
from geomid_ros.checks.recording_check import CheckTask, RecordingCheck
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

ROBOTS = [("arm3", 1), ("arm7", 2)]
DEGREES = 180.0 / np.pi


@cache
def case(name: str, seed: int) -> Case:
    return arm(name, seed, seconds=10.0)


def checked(model: MeasurementModel, recorded: Samples, gains: FloatArray | None = None) -> RecordingCheck:
    """A check that was told of a recording in pieces."""
    check = RecordingCheck(CheckTask(model, np.ones(len(model.robot.joints)) if gains is None else gains, {}))
    for begin in range(0, len(recorded), 300):
        check.add(recorded.select(slice(begin, begin + 300)))
    return check


def test_a_recording_is_due_again_once_it_is_twice_as_long() -> None:
    of = case("arm3", 1)
    apart = -(-110_000_000 // int(of.samples.stamps[1] - of.samples.stamps[0]))
    recorded = of.samples.select(slice(None, None, apart))  # all of them are kept
    assert len(recorded) >= 90
    check = RecordingCheck(CheckTask(of.model, np.ones(len(of.model.robot.joints)), {}))
    due = []
    for index in range(90):
        check.add(recorded.select(slice(index, index + 1)))
        if check.due:
            due.append(index + 1)
            check.findings()
    assert due == [30, 61]


def findings(model: MeasurementModel, recorded: Samples, gains: FloatArray | None = None) -> tuple[RecordingFault, ...]:
    """What it says."""
    return checked(model, recorded, gains).findings()


def named(model: MeasurementModel, recorded: Samples, gains: FloatArray | None = None) -> Cause:
    """The one cause that is named."""
    (finding,) = findings(model, recorded, gains)
    assert finding.sure, finding
    assert finding.cause.sentence in finding.sentence
    return finding.cause


@pytest.fixture(params=ROBOTS[:1], ids=str)
def robot(request: pytest.FixtureRequest) -> Case:
    """The small arm, unless a test says another one."""
    return case(*request.param)


both_robots = pytest.mark.parametrize("robot", ROBOTS, indirect=True, ids=str)


def times(of: Case, factor: float, joint: int | None = None) -> Samples:
    """The efforts of a joint, or of all, times a factor."""
    factors = np.ones(of.samples.effort.shape[1])
    factors[slice(None) if joint is None else joint] = factor
    return replace(of.samples, effort=factors * of.samples.effort)


def turned(of: Case, scale: float, joint: int | None = None, rate: float = 1.0, back: bool = False) -> Samples:
    """The positions of a joint, or of all, times a scale, by a clock that runs so many times as fast; the efforts, too,
    if they count ``back``."""
    own, scales = of.samples, np.ones(of.samples.effort.shape[1])
    scales[slice(None) if joint is None else joint] = scale
    return replace(
        own,
        position=scales * own.position,
        velocity=rate * scales * own.velocity,
        acceleration=rate**2 * scales * own.acceleration,
        effort=scales * own.effort if back else own.effort,
    )


def exchanged(of: Case, first: int, names: bool = False) -> Samples:
    """The efforts of a joint and the next, or all that has their names."""
    order = np.arange(len(of.model.robot.joints))
    order[[first, first + 1]] = first + 1, first
    return of.samples.with_joints(order) if names else replace(of.samples, effort=of.samples.effort[:, order])


def unsigned(of: Case) -> Samples:
    """The first joint, which has no weight to carry and goes to and fro, sends magnitudes."""
    return replace(of.samples, effort=np.column_stack([np.abs(of.samples.effort[:, :1]), of.samples.effort[:, 1:]]))


def rubbing(of: Case) -> Samples:
    """Friction is compensated too much: weights and inertias still decide on the sign."""
    own = of.samples
    return replace(own, effort=own.effort - 1.5 * np.std(own.effort, axis=0) * np.tanh(own.velocity / 0.05))


def with_another(of: Case) -> Samples:
    """The position of the third joint holds that of the parallel one."""
    (carrier,) = of.model.robot.parallel_joints(2)
    both = {name: getattr(of.samples, name).copy() for name in ("position", "velocity", "acceleration")}
    for values in both.values():
        values[:, 2] += values[:, carrier]
    return replace(of.samples, **both)


def noise(of: Case) -> Samples:
    return replace(of.samples, effort=np.random.default_rng(3).normal(size=of.samples.effort.shape))


def without_links(of: Case) -> Samples:
    """The efforts of friction alone, as those that are compensated for gravity and inertia."""
    own = of.samples
    friction = np.std(own.effort, axis=0) * (np.tanh(own.velocity / 0.02) + own.velocity)
    return replace(own, effort=friction + 0.01 * noise(of).effort)


THREE, SEVEN = ROBOTS
FAULTS: list[tuple[str, tuple[int, ...], str, Callable[[Case], Samples], tuple[str, int]]] = [
    ("sign", (), "effort_gain: -1.0", lambda of: times(of, -1.0), THREE),
    ("sign", (0,), ".joint1.effort_gain: -1.0", lambda of: times(of, -1.0, 0), THREE),
    ("sign", (6,), "reversed", lambda of: times(of, -1.0, 6), SEVEN),
    ("order", (0, 1), "swapped", partial(exchanged, first=0), SEVEN),
    ("order", (1, 2), "swapped", partial(exchanged, first=1), THREE),
    ("names", (0, 1), "swapped", partial(exchanged, first=0, names=True), THREE),
    ("names", (3, 4), "swapped", partial(exchanged, first=3, names=True), SEVEN),
    ("gain", (), "in mN m, or masses of the URDF that are placeholders", lambda of: times(of, 1000.0), THREE),
    ("gain", (), "in A, on the motor side", lambda of: times(of, 0.07), SEVEN),
    ("gain", (1,), "mN m", lambda of: times(of, 1000.0, 1), THREE),
    ("unrelated", (), "neither the gravity nor the motion", noise, THREE),
    ("unrelated", (), "neither the gravity nor the motion", without_links, SEVEN),
    ("magnitude", (0,), "unsigned", unsigned, THREE),
    ("friction", (), "over-compensated", rubbing, THREE),
    ("position", (), "in degrees", lambda of: turned(of, DEGREES), THREE),
    ("position", (1,), "in degrees", lambda of: turned(of, DEGREES, 1), SEVEN),
    ("position", (), "in revolutions", lambda of: turned(of, 0.5 / np.pi), THREE),
    ("position", (), "in steps of 4096 a turn", lambda of: turned(of, 2048.0 / np.pi), SEVEN),
    ("time", (), "2 times as slow: with 2 times the time between", lambda of: turned(of, 1.0, rate=2.0), SEVEN),
    ("time", (), "1000 times the time between", lambda of: turned(of, 1.0, rate=1e3), THREE),
    ("axis", (1,), "turn opposite", lambda of: turned(of, -1.0, 1, back=True), THREE),
    ("absolute", (2, 1), "include that of", with_another, THREE),
]
"""Faults by kind: the joints that are named, all if none; what is said; and of which robot."""


@pytest.mark.parametrize(("kind", "joints", "said", "plant", "which"), FAULTS)
def test_what_is_planted_is_named(
    kind: str, joints: tuple[int, ...], said: str, plant: Callable[[Case], Samples], which: tuple[str, int]
) -> None:
    """In a unit, the factor is told as far as the masses are known."""
    of = case(*which)
    cause, names = named(of.model, plant(of)), of.model.robot.joint_names
    assert cause.kind == kind
    assert said in cause.sentence
    if kind != "friction":
        assert cause.places == tuple(names[joint] for joint in joints or range(len(names)))
    if kind == "gain" and not joints:
        factor = np.std(plant(of).effort[:, 0]) / np.std(of.samples.effort[:, 0])
        assert cause.settings["effort_gain"] * factor == pytest.approx(1.0, rel=0.6)


def at_rest(of: Case) -> Samples:
    still = np.zeros_like(of.samples.velocity)
    return replace(noise(of), position=still + of.samples.position[0], velocity=still, acceleration=still)


SOUND: dict[str, Callable[[Case], Samples]] = {
    "as it is": lambda of: of.samples,
    "a gain within reason": lambda of: times(of, 2.0),  # it cannot be told from masses
    "three seconds": lambda of: times(of, -1.0).select(slice(250)),
    "at rest": at_rest,
    "a zero that is hardly off": lambda of: replace(
        of.samples, position=of.samples.position + np.radians(1.0) * (np.arange(of.samples.effort.shape[1]) == 1)
    ),
}


@pytest.mark.parametrize(("recorded", "which"), [("as it is", THREE), *((recorded, SEVEN) for recorded in SOUND)])
def test_a_sound_recording_is_not_doubted(recorded: str, which: tuple[str, int]) -> None:
    robot = case(*which)
    check = checked(robot.model, SOUND[recorded](robot))
    assert check.findings() == ()
    assert check.remarks == () or recorded != "as it is"


def smooth(share: FloatArray) -> FloatArray:
    """From 0 to 1 as smoothly as can be: place, speed and acceleration ``(3, ...)`` over the time from 0 to 1."""
    way, speed = 10 * share**3 - 15 * share**4 + 6 * share**5, 30 * share**2 - 60 * share**3 + 30 * share**4
    return np.array([way, speed, 60 * share - 180 * share**2 + 120 * share**3])


def one_after_the_other(rng: np.random.Generator, joints: int, rest: int) -> Motion:
    """Each joint moves once while the others stand still, 3 s as smoothly as can be, and all wait for some instants."""
    way = smooth(np.arange(300)[:, None] / 300.0)
    here, parts = rng.uniform(-1.2, 1.2, joints), []
    for joint in rng.permutation(joints):
        step = np.zeros(joints)
        step[joint] = rng.uniform(-1.2, 1.2) - here[joint]
        parts.append(np.array([here + way[0] * step, way[1] * step / 3.0, way[2] * step / 9.0]))
        here = here + step
        parts.append(np.broadcast_to(np.array([here, np.zeros(joints), np.zeros(joints)])[:, None], (3, rest, joints)))
    return Motion(*np.concatenate(parts, axis=1))


@pytest.mark.parametrize(("name", "seed", "rest"), [("arm3", 2, 50), ("arm7", 2, 0)])
def test_a_robot_whose_joints_move_one_after_the_other_is_sound(name: str, seed: int, rest: int) -> None:
    """Where a joint waits, others are where they never were while it moved; and dry friction is most of its effort."""
    of, rng = case(name, seed), np.random.default_rng([seed, 77])
    moving = one_after_the_other(rng, len(of.model.robot.joints), rest)
    measured = efforts(of.model.robot, of.true, moving)
    rubbing = np.std(measured, axis=0) * (np.tanh(moving.velocity / 0.01) + moving.velocity)
    for recorded in (measured, measured + 0.2 * rubbing):
        noise = (0.02 * np.std(recorded, axis=0) + 1e-4) * rng.normal(size=recorded.shape)
        assert findings(of.model, samples(moving, recorded + noise)) == ()


@both_robots
def test_friction_that_sticks_between_motions_is_sound(robot: Case) -> None:
    """Where a robot waits between its motions, dry friction has any value within its limits: here the largest."""
    of, rng = robot, np.random.default_rng(78)
    robot = of.model.robot.with_gravity(np.zeros(3))
    joints = len(robot.joints)
    moving = Motion(*np.concatenate([_one_way(rng, joints) for _ in range(12)], axis=1))
    measured = efforts(robot, of.true, moving, np.zeros(3))
    waits = np.repeat(rng.choice([-1.0, 1.0], (12, joints)), len(moving) // 12, axis=0)
    dry = np.where(np.any(moving.velocity, axis=1, keepdims=True), np.tanh(moving.velocity / 0.01), waits)
    recorded = measured + 4.0 * np.std(measured, axis=0) * dry + 0.01 * rng.normal(size=dry.shape)
    check = checked(MeasurementModel(robot, of.effects), samples(moving, recorded))
    assert check.findings() == ()
    assert check.remarks == ()


def _one_way(rng: np.random.Generator, joints: int) -> FloatArray:
    """All joints move to another pose within 1 s, as smoothly as can be, and wait as long ``(3, 200, joints)``."""
    begin, end = rng.uniform(-1.2, 1.2, (2, joints))
    return (
        smooth(np.minimum(np.arange(200) / 100.0, 1.0)[:, None]) * (end - begin)
        + np.outer([1.0, 0.0, 0.0], begin)[:, None]
    )


@pytest.mark.parametrize("robot", ROBOTS[1:], indirect=True, ids=str)
def test_what_is_to_be_written_depends_on_the_gains_that_were_configured(robot: Case) -> None:
    joints = robot.model.robot.joint_names
    gains = np.arange(2.0, 2.0 + len(joints))
    cause = named(robot.model, times(robot, -1.0), gains)
    assert cause.settings == {f"joint.{joint}.effort_gain": -gain for joint, gain in zip(joints, gains, strict=True)}
    assert all(name in cause.sentence for name in cause.settings)


def two_arms() -> tuple[Robot, list[str]]:
    """Two of the small arm on one base, bent to either side; the left one is heavier."""
    parts = []
    for side, place, mass in (("left", 1.0, 2.0), ("right", -1.0, 1.0)):
        for number, (axis, length) in enumerate((("0 0 1", 0.2), ("0 1 0", 0.4), (f"{place} 1 0", 0.4)), 1):
            parent = "base" if number == 1 else f"{side}_link{number - 1}"
            origin = f"0 {0.3 * place} 0" if number == 1 else f"{length} {0.1 * place} 0.1"
            parts.append(
                f'<link name="{side}_link{number}"><inertial><origin xyz="0.15 {0.05 * place} 0.02"/>'
                f'<mass value="{mass * (4 - number)}"/>'
                '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>'
                f'<joint name="{side}_joint{number}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{side}_link{number}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
                '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
            )
    own = Robot(f'<robot name="two"><link name="base"/>{"".join(parts)}</robot>')
    return own, list(own.joint_names)


def test_left_and_right_are_exchanged() -> None:
    own, names = two_arms()
    model = MeasurementModel(own, ())
    moving = motion(np.random.default_rng(6), len(names), 10.0)
    feels = efforts(own, truth(np.random.default_rng(5), own), moving)
    sound = samples(moving, feels + 0.05 * np.random.default_rng(8).normal(size=feels.shape))
    assert findings(model, sound) == ()
    order = np.roll(np.arange(len(names)), len(names) // 2)
    assert names[order[0]].replace("left", "right") == names[0].replace("left", "right")
    cause = named(model, sound.with_joints(order))
    assert cause.kind == "names"
    assert set(cause.places) == set(names)


def under_gravity(of: Case, gravity: tuple[float, float, float]) -> Samples:
    """What is recorded of the robot under another gravity."""
    moving = motion(np.random.default_rng(7), len(of.model.robot.joints), 10.0)
    feels = efforts(of.model.robot, of.true, moving, gravity)
    return samples(moving, feels + 0.05 * np.random.default_rng(8).normal(size=feels.shape))


@pytest.mark.parametrize(
    ("robot", "gravity"), [(ROBOTS[0], (9.81, 0.0, 0.0)), (ROBOTS[1], (0.0, 6.94, -6.94))], indirect=["robot"]
)
def test_gravity_acts_in_another_direction(robot: Case, gravity: tuple[float, float, float]) -> None:
    cause = named(robot.model, under_gravity(robot, gravity))
    assert cause.kind == "gravity"
    written = np.array(cause.settings["gravity"])
    assert np.linalg.norm(written) == pytest.approx(9.81, abs=0.02)
    # It may turn about an axis along which all of the arm hangs alike.
    assert written @ np.array(gravity) > np.cos(np.radians(30.0)) * 9.81**2


@both_robots
def test_a_base_that_is_not_level_is_remarked_and_hides_no_fault(robot: Case) -> None:
    """Doubtful enough to be measured, not to be an error: by 2.4 degrees, by ten where few joints tell less."""
    own = robot.model.robot
    x, y = np.array([0.35, -0.2]) * (4.0 if len(own.joints) == 3 else 1.0)
    gravity = (x, y, -np.sqrt(9.81**2 - x**2 - y**2))
    recorded = under_gravity(robot, gravity)
    check = checked(robot.model, recorded)
    assert check.findings() == ()
    (remark,) = check.remarks
    written = [float(word) for word in remark.partition("--gravity ")[2].split()[:3]]
    assert written == pytest.approx(gravity, abs=0.15)
    signs = np.where(np.arange(len(own.joints)) == 1, -1.0, 1.0)
    cause = named(robot.model, replace(recorded, effort=signs * recorded.effort))
    assert (cause.kind, cause.places) == ("sign", (own.joint_names[1],))


@both_robots
def test_gravity_is_not_in_the_efforts(robot: Case) -> None:
    (finding,) = findings(robot.model, under_gravity(robot, (0.0, 0.0, 0.0)))
    assert finding.cause.kind == "compensated"
    assert finding.cause.settings == {"gravity": [0.0, 0.0, 0.0]}
    assert finding.sure or len(robot.model.robot.joints) == 3, "few joints tell less"


def test_an_effort_that_never_changes_is_told_and_the_others_are_judged(robot: Case) -> None:
    """And one that is not measured is none of them."""
    effort = -robot.samples.effort
    effort[:, 0], effort[:, -1] = 0.0, np.nan
    first, second = findings(robot.model, replace(robot.samples, effort=effort))
    assert robot.model.robot.joint_names[-1] not in second.cause.places
    assert (first.cause.kind, first.cause.places) == ("constant", (robot.model.robot.joint_names[0],))
    assert second.cause.kind == "sign"


def test_a_payload_is_no_fault() -> None:
    own = Robot(shipped("arm7"))
    true = truth(np.random.default_rng(5), own)
    true.links[-1] += np.array([2.0, 0.0, 0.0, 0.2, *(0.02 * np.array([2.0, 0.0, 2.0, 0.0, 0.0, 1.0]))])
    moving = motion(np.random.default_rng(6), len(own.joints), 10.0)
    assert findings(MeasurementModel(own, ()), samples(moving, efforts(own, true, moving))) == ()


@pytest.mark.parametrize("size", [1e-12, 1e9])
def test_efforts_of_any_size_are_judged(robot: Case, size: float) -> None:
    """Rounding leaves matrices of columns that are so much larger indefinite; then it decides what is said."""
    (finding,) = checked(robot.model, replace(robot.samples, effort=size * robot.samples.effort)).findings()
    assert finding.sure
    assert finding.cause.kind == "gain" or size < 1.0
    nothing = size * np.random.default_rng(0).normal(size=robot.samples.effort.shape)
    (finding,) = checked(robot.model, replace(robot.samples, effort=nothing)).findings()
    assert finding.cause.kind == "unrelated", "noise is no effort"


def test_an_effort_that_changes_for_half_of_the_time_is_judged() -> None:
    """A dead band may leave nothing of it in the other half, which then says nothing of any cause."""
    of = case("arm7", 1)
    effort = of.samples.effort.copy()
    effort[len(effort) // 2 - 20 :, -1] = 0.0
    assert len(findings(of.model, replace(of.samples, effort=-effort))) > 0


def test_efforts_that_are_rarely_measured_at_once_are_said_to_be_unchecked() -> None:
    of = case("arm7", 1)
    effort = of.samples.effort.copy()
    for joint in range(3):  # each is missing for a third of the time, another one for the next
        effort[joint * len(effort) // 3 : (joint + 1) * len(effort) // 3, joint] = np.nan
    check = checked(of.model, replace(of.samples, effort=-effort))
    assert check.findings() == ()
    assert check.remarks == (NOT_CHECKED,)


def test_a_joint_whose_effort_is_missing_is_said_to_measure_none(robot: Case) -> None:
    names = robot.model.robot.joint_names
    effort = robot.samples.effort.copy()
    effort[:, 1] = np.nan
    assert checked(robot.model, replace(robot.samples, effort=effort)).unmeasured == [names[1]]
    assert checked(robot.model, robot.samples).unmeasured == []
