"""Whether a gyroscope turns as the legs say: planted faults, and what tells nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from model.robots import random_samples, urdf, with_values

from geomid_ros.checks.moving_base import gyroscope, never_lifted, on_all_feet, reversed_efforts, unknown_base
from geomid_ros.checks.recording_check import CheckResult, CheckTask, Excerpt, RecordingCheck
from geomid_ros.checks.unexplained import unexplained_base
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import Contact, Legs
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
STEP = 20_000_000  # [ns]
COUNT = 900
ROBOT = Robot(urdf("go2.urdf"), floating_base=True)


def legs(count: int = 4) -> Legs:
    return Legs(ROBOT, [Contact(foot, 0.02) for foot in FEET[:count]])


def turned_at(seconds: FloatArray) -> FloatArray:
    """A velocity of the base ``(N, 6)`` that does not repeat."""
    return np.asarray(np.sin(np.sqrt(np.arange(2.0, 8.0)) * seconds[:, None] + np.arange(6.0)))


def on_feet(turning: FloatArray, measured: FloatArray) -> Samples:
    """The robot stands with bent knees while its base moves as given ``(N, 6)``, its feet where they are, and as a
    gyroscope measures ``(N, 3)``."""
    one = random_samples(ROBOT, 1).select(slice(0, 1))
    bent = 0.2 * one.position - 1.4 * np.array([name.endswith("calf_joint") for name in ROBOT.joint_names])
    values = {name: np.repeat(array, len(turning), axis=0) for name, array in one.arrays.items()}
    values["stamps"] = STEP * np.arange(1, len(turning) + 1)
    samples = with_values(Samples(**values, entries=one.entries), position=np.tile(bent, (len(turning), 1)))
    q = ROBOT.configuration(samples)[0][:1]
    jacobian = np.concatenate([ROBOT.contact_jacobians(q, foot, 0.02)[0, :3] for foot in FEET])
    velocity = -np.linalg.solve(jacobian[:, 6:], jacobian[:, :6] @ turning.T).T
    return with_values(samples, velocity=velocity, base_velocity=np.column_stack([turning[:, :3], measured]))


SECONDS = 0.02 * np.arange(COUNT)
TURNING = turned_at(SECONDS)


def about_z(degrees: float) -> FloatArray:
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def test_feet_that_stand_tell_how_the_base_turns() -> None:
    samples = on_feet(TURNING, TURNING[:, 3:])
    np.testing.assert_allclose(legs().base_rate(samples), TURNING[:, 3:], atol=1e-9)


NOISE = np.random.default_rng(0).normal(size=(COUNT, 3))
MEASURED: dict[str, tuple[FloatArray, FloatArray, str]] = {  # the base's motion, what is measured, and what is said
    "right": (TURNING, TURNING[:, 3:] + 0.05 * NOISE, ""),
    "late": (TURNING, turned_at(SECONDS - 0.06)[:, 3:], "60 ms late:"),
    "early": (TURNING, turned_at(SECONDS + 0.25)[:, 3:], "200 ms early or more"),
    "hardly late": (TURNING, turned_at(SECONDS - 0.017)[:, 3:], ""),
    "hardly early": (TURNING, turned_at(SECONDS + 0.017)[:, 3:], ""),
    "turned": (TURNING, TURNING[:, 3:] @ about_z(25.0), "turned by about 25 degrees"),
    "turned round": (TURNING, TURNING[:, 3:] @ about_z(180.0), "about 180 "),
    "hardly turned": (TURNING, TURNING[:, 3:] @ about_z(8.0), ""),
    "in degrees": (TURNING, np.degrees(TURNING[:, 3:]), "57.3 times that rotation: publish it in rad/s"),
    "something else": (TURNING, NOISE, ""),
    "standing still": (np.zeros((COUNT, 6)), np.zeros((COUNT, 3)), ""),
    "still but for rounding": (1e-15 * TURNING, 1e-3 * NOISE, ""),
}


@pytest.mark.parametrize("case", MEASURED)
def test_what_is_wrong_with_a_gyroscope_is_told_and_by_how_much(case: str) -> None:
    turning, measured, words = MEASURED[case]
    found = " ".join(finding.sentence for finding in gyroscope(legs(), on_feet(turning, measured)))
    assert words in found
    assert bool(found) == bool(words)


def test_around_a_foot_that_is_in_the_air_nothing_is_compared() -> None:
    samples = on_feet(TURNING[:100], TURNING[:100, 3:])
    standing = np.ones((100, 4), dtype=bool)
    standing[40, 2] = False
    efforts = ROBOT.joint_efforts(*ROBOT.configuration(samples)) - loaded(samples)
    kept = on_all_feet(legs(), with_values(samples, effort=efforts, standing=standing))
    assert (kept.stamps // STEP - 1).tolist() == [*range(30), *range(51, 100)]


def loaded(samples: Samples) -> FloatArray:
    """What feet that each bear a quarter of the weight add to the efforts, with the other sign ``(N, joints)``."""
    q = ROBOT.configuration(samples)[0]
    jacobians = sum(ROBOT.contact_jacobians(q, foot, 0.02)[:, :3] for foot in FEET)
    return np.asarray(0.25 * ROBOT.weight * jacobians[:, 2, 6:])


def carrying() -> Samples:
    """Postures of a robot on its feet, with efforts that carry and accelerate it, wrong masses and noise included."""
    samples = on_feet(TURNING[:200], TURNING[:200, 3:])
    noise = np.random.default_rng(0).normal(size=(2, *samples.position.shape))
    moved = {"position": samples.position + 0.2 * noise[0], "standing": np.ones((200, 4), dtype=bool)}
    samples = with_values(samples, **moved, base_acceleration=0.5 * TURNING[:200])
    q, v, a = ROBOT.configuration(samples)
    links = 1.2 * np.array([body.parameters for body in ROBOT.bodies]).ravel()
    efforts = ROBOT.joint_effort_rows(q, v, a, base=True).reshape(200, 18, -1) @ links
    jacobians = np.concatenate([ROBOT.contact_jacobians(q, foot, 0.02)[:, :3] for foot in FEET], axis=1)
    forces = np.linalg.pinv(jacobians[:, :, :6].transpose(0, 2, 1)) @ efforts[:, 12:, None]
    of_feet = (jacobians[:, :, 6:].transpose(0, 2, 1) @ forces)[:, :, 0]
    return with_values(samples, effort=efforts[:, :12] - of_feet + 0.1 * noise[1])


@pytest.mark.parametrize("joints", [[], [4], [0, 1, 2, 6, 7, 8], list(range(12))])
def test_reversed_efforts_of_legs_are_named(joints: list[int]) -> None:
    """All at once are the weight's, or the IMU's."""
    samples, gains = carrying(), np.where(np.isin(np.arange(12), joints), -1.0, 1.0)
    found = reversed_efforts(legs(), with_values(samples, effort=samples.effort * gains), ROBOT.joint_names, gains)
    assert len(found) == (0 < len(joints) < 12)
    for cause in found:
        assert cause.places == tuple(ROBOT.joint_names[joint] for joint in joints)
        assert cause.settings == {f"joint.{name}.effort_gain": 1.0 for name in cause.places}


def test_a_sign_of_an_effort_must_repeat() -> None:
    """In both halves: what changes amid a recording is no sign."""
    samples = carrying()
    effort = samples.effort.copy()
    effort[len(effort) // 2 :, 0] *= -0.5
    assert reversed_efforts(legs(), with_values(samples, effort=effort), ROBOT.joint_names, np.ones(12)) == []


def test_half_of_the_force_on_the_base_must_be_explained() -> None:
    """And of the moment, each as a vector: one axis may be mostly noise."""
    model, samples = MeasurementModel(ROBOT, [], contacts=legs().contacts), carrying()
    links = 1.2 * model.nominal_parameters
    assert unexplained_base(model, [], links) == []
    assert unexplained_base(model, [samples], links) == []
    one_leg = samples.effort * np.where(np.arange(12) < 3, -1.0, 1.0)
    (cause,) = unexplained_base(model, [with_values(samples, effort=one_leg)], links)
    assert sorted(cause.places) == ["force", "moment"]
    assert cause.sentence.startswith("on the base the '")


def test_what_is_kept_for_other_sensors_needs_no_feet() -> None:
    """Of a trot, in which a foot is always in the air."""
    seen = list[Excerpt]()

    def judge(_: CheckTask, excerpt: Excerpt) -> CheckResult:
        seen.append(excerpt)
        return CheckResult()

    model = MeasurementModel(ROBOT, (), contacts=legs().contacts)
    check = RecordingCheck(CheckTask(model, np.ones(12), {}), judge)
    standing = np.ones((COUNT, 4), dtype=bool)
    standing[::8, 0] = False
    check.add(with_values(on_feet(TURNING, TURNING[:, 3:]), standing=standing))
    check.findings()
    assert seen[0].recent_stance is None
    assert seen[0].recent_motion is not None
    assert len(seen[0].recent_motion) > COUNT // 2


def test_a_leg_of_which_any_joint_has_been_fitted_was_in_the_air() -> None:
    """Another joint of it may have measured nothing."""
    model, own = MeasurementModel(ROBOT, (), contacts=[Contact(foot, 0.02) for foot in FEET]), legs(2)
    lacking = [ROBOT.joint_names[joint] for joint in (own.joints[0][0], *own.joints[1])]
    rms = [np.nan if channel in lacking else 1.0 for channel in ROBOT.joint_names]
    estimate: Any = SimpleNamespace(channels=ROBOT.joint_names, rms=rms)
    (sentence,) = never_lifted(model, estimate)
    assert sentence.startswith(f"the training data show {FEET[1]} never long enough")


def test_a_base_is_known_by_any_of_its_channels() -> None:
    """And of a robot without legs nothing is asked."""
    model = MeasurementModel(ROBOT, (), contacts=[Contact(foot, 0.02) for foot in FEET])
    rms = np.full(len(model.channels), np.nan)
    estimate: Any = SimpleNamespace(rms=rms)
    assert [cause.kind for cause in unknown_base(model, estimate)] == ["ground"]
    rms[model.layout.base.start] = 1.0
    assert unknown_base(model, estimate) == []
    arm: Any = SimpleNamespace(legs=None, layout=SimpleNamespace(base=()))
    assert unknown_base(arm, estimate) == []
