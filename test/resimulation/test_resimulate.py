"""Simulation of recordings: in short windows, a right model has the error that noise makes, a wrong one has more, in
proportion; from its commands, the controller is found, and a right model needs the measured efforts."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from files.effects import PAYLOAD, effect
from model.robots import with_values

from geomid_ros.errors import InputError
from geomid_ros.files.models.urdf import with_effects
from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.gap.result import GapResult
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import (
    NotSimulatedError,
    ResidualNoise,
    Resimulated,
    resimulate,
    resimulate_closed_loop,
    uniform_segments,
)
from geomid_ros.resimulation.written_robot import WrittenRobot, load_mujoco
from geomid_ros.types import FloatArray

from .recordings import ARM, FLOOR, JOINTS, MODEL, PERIOD, Added, files, motion, noise_example, recording

# 200 windows: their root mean square is known to 5 %, and so is the unit's; four of these.
SCATTER = 0.28
SECOND = np.array([0.0, 1.0, 0.0])
EXACT = 0.1  # of the noise's error: what integration leaves of a model that is right and data without noise


def spring(stiffness: float) -> tuple[Added, Any]:
    """A spring at joint2: what the motors supply, and the effect."""

    def added(position: FloatArray, *_: FloatArray) -> FloatArray:
        return stiffness * (position - 0.3) * SECOND

    return added, effect("spring", "joint2", stiffness=stiffness, equilibrium=0.3)


def simulated(before: ModelFiles, after: ModelFiles, *recordings: Samples) -> Resimulated:
    return resimulate(MODEL, before, after, recordings, noise_example())


def test_a_right_model_has_the_error_that_noise_makes(tmp_path: Path) -> None:
    found = simulated(files(tmp_path, "a"), files(tmp_path, "a"), recording())
    assert list(found.after) == [channel.name for channel in MODEL.channels]
    assert found.before == found.after
    assert list(found.after.values()) == pytest.approx([1.0] * 9, abs=SCATTER)


def test_a_wrong_model_has_more_in_proportion(tmp_path: Path) -> None:
    ratios = []
    for stiffness in (2.0, 4.0):
        added, known = spring(stiffness)
        data = recording(added, noise=0.0, duration=8.0)
        found = simulated(files(tmp_path, "before"), files(tmp_path, "after", [known]), data)
        assert max(found.after.values()) < EXACT
        ratios.append(found.before["joint2"])
    assert ratios[0] > 3.0
    assert ratios[1] / ratios[0] == pytest.approx(2.0, rel=0.1)


def coulomb(_: FloatArray, velocity: FloatArray, __: FloatArray) -> FloatArray:
    return 0.5 * np.sign(velocity)


def stribeck(_: FloatArray, velocity: FloatArray, __: FloatArray) -> FloatArray:
    return np.sign(velocity) * (0.5 + 0.5 * np.exp(-((velocity / 0.3) ** 2)))


STRIBECK = effect("stribeck_friction", "joint2", level=0.5, excess=0.5, speed=0.3)
CASES: dict[str, tuple[KnownEffect, Added]] = {
    "viscous": (effect("viscous_friction", "joint2", coefficient=1.5), lambda _, v, __: 1.5 * v),
    "coulomb": (effect("coulomb_friction", "joint2", level=0.5), coulomb),
    "stribeck": (STRIBECK, stribeck),
    "rotor": (effect("rotor_inertia", "joint2", inertia=0.4), lambda _, __, a: 0.4 * a),
}


def assert_closes(
    tmp_path: Path, known: KnownEffect, *recordings: Samples, of: Collection[str] = ("joint2",)
) -> Resimulated:
    """Without the effect these channels are off, with it none is."""
    found = simulated(files(tmp_path, "before"), files(tmp_path, "after", [known]), *recordings)
    assert min(found.before[name] for name in of) > 3.0
    assert max(found.after.values()) < 1.0 + SCATTER
    return found


@pytest.mark.parametrize("name", CASES)
def test_effects_of_a_joint_close_the_gap(tmp_path: Path, name: str) -> None:
    known, added = CASES[name]
    assert_closes(tmp_path, known, recording(lambda q, v, a: SECOND * added(q, v, a)))


def test_friction_that_samples_show_less_of_at_rest_holds_a_joint(tmp_path: Path) -> None:
    """At rest it may have either sign, so that samples tell of less than there is: an excess below zero."""
    moving = recording(lambda q, v, a: SECOND * coulomb(q, v, a))
    resting = recording(lambda q, *_: SECOND * np.full_like(q, 0.3), moves=False)
    known = effect("stribeck_friction", "joint2", level=0.5, excess=-0.5, speed=0.03)
    assert_closes(tmp_path, known, moving, resting)


def test_friction_by_load_closes_the_gap(tmp_path: Path) -> None:
    """The friction is c times what the gear passes on, which is the rest of the effort."""
    smooth = recording(noise=0.0)
    friction = 0.1 * np.abs(smooth.effort) * np.sign(smooth.velocity) * SECOND
    data = with_values(recording(), effort=recording().effort + friction)
    assert_closes(tmp_path, effect("load_friction", "joint2", coefficient=0.1), data)


def test_a_spring_loads_no_gear(tmp_path: Path) -> None:
    """Nor does other friction: friction by load is of the effort that the links need."""
    added, known = spring(4.0)
    links = recording(noise=0.0)
    friction = 0.2 * np.abs(links.effort) * np.sign(links.velocity) * SECOND
    data = recording(added)
    data = with_values(data, effort=data.effort + friction)
    both = [known, effect("load_friction", "joint2", coefficient=0.2)]
    found = simulated(files(tmp_path, "before", [known]), files(tmp_path, "after", both), data)
    assert found.before["joint2"] > 3.0
    assert max(found.after.values()) < 1.0 + SCATTER


def test_efforts_are_corrected_as_the_sidecar_says(tmp_path: Path) -> None:
    """measured(t) = gain true(t - delay) + offset."""
    exact, early = recording(noise=0.0), recording(noise=0.0)
    ahead = round(0.02 / PERIOD)
    delayed = np.roll(early.effort, ahead, axis=0) * [1.0, 1.3, 1.0] + [0.0, 0.0, 0.4]
    inside = slice(10, -10)
    data = with_values(exact, effort=delayed).select(inside)
    known = [
        effect("effort_delay", delay=0.02),
        effect("effort_gain", "joint2", gain=1.3),
        effect("effort_offset", "joint3", offset=0.4),
    ]
    found = simulated(files(tmp_path, "before"), files(tmp_path, "after", known), data)
    assert min(found.before["joint2"], found.before["joint3"]) > 3.0
    assert max(found.after.values()) < 2 * EXACT


def test_wrenches_are_judged_with_their_offset(tmp_path: Path) -> None:
    data = recording()
    shifted = with_values(data, wrenches=data.wrenches - [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # the sign is reversed
    found = assert_closes(tmp_path, effect("wrench_offset", "/wrench", fz=1.0), shifted, of=["wrench/fz"])
    assert found.before["wrench/fx"] == found.after["wrench/fx"]


def test_a_payload_shows_in_joints_and_wrench(tmp_path: Path) -> None:
    """Recorded with it: here the URDF is the truth, and the one without payload is wrong."""
    loaded = Robot(with_effects(ARM, [effect("payload", "tool", **PAYLOAD)]), cuts=["wrist_ft"])
    right, wrong = files(tmp_path, "right"), files(tmp_path, "wrong", robot=loaded)
    assert effect("payload", "tool", **PAYLOAD).body[0] == 1.5
    found = simulated(wrong, right, recording())
    assert min(found.before[name] for name in ("joint2", "joint3", "wrench/fz", "wrench/tx")) > 5.0
    assert max(found.after.values()) < 1.0 + SCATTER


def link_motion(stiffness: float) -> Samples:
    """A recording as the motors see it: they are ahead of the links by the effort over the stiffness, at joint2."""
    exact = recording(noise=0.0)
    ahead = exact.effort / stiffness * SECOND
    rate = np.gradient(ahead, PERIOD, axis=0, edge_order=2)
    return with_values(
        recording(),
        position=exact.position + ahead,
        velocity=exact.velocity + rate,
        acceleration=exact.acceleration + np.gradient(rate, PERIOD, axis=0, edge_order=2),
    )


def test_an_elastic_gear_is_simulated(tmp_path: Path) -> None:
    known = effect("joint_elasticity", "joint2", stiffness=100.0)
    found = simulated(files(tmp_path, "before"), files(tmp_path, "after", [known]), link_motion(100.0))
    assert found.before["joint2"] > 3.0
    assert found.after["joint2"] < 1.6


def test_joints_that_cannot_be_judged_follow_their_measured_motion(tmp_path: Path) -> None:
    """joint1 has no effort, joint3 is held by a brake: joint2 is judged as if all were well."""
    position, velocity, effort = recording().position.copy(), recording().velocity.copy(), recording().effort.copy()
    effort[:, 0] = np.nan
    unmeasured = with_values(recording(), effort=effort)
    found = simulated(files(tmp_path, "a"), files(tmp_path, "a"), unmeasured)
    assert {"joint1"} == set(JOINTS) - found.after.keys()
    assert max(found.after.values()) < 1.0 + SCATTER
    effort = effort.copy()
    position[:, 2], velocity[:, 2], effort[:, 2] = 0.2, 0.0, 77.0
    braked = with_values(unmeasured, position=position, velocity=velocity, effort=effort)
    assert {"joint1", "joint3"} == set(JOINTS) - simulated(
        files(tmp_path, "a"), files(tmp_path, "a"), braked
    ).after.keys()


def test_a_joint_that_was_locked_stays_at_zero(tmp_path: Path) -> None:
    locked = Robot(ARM, cuts=["wrist_ft"], locked_joints=["joint3"])
    robot = WrittenRobot(files(tmp_path, "locked", robot=locked), JOINTS[:2])
    data = robot.mujoco.MjData(robot.model)
    data.qpos[robot.dofs], data.qvel[robot.dofs] = 0.5, 3.0
    robot.mujoco.mj_forward(robot.model, data)
    assert np.all(np.abs(data.qacc[robot.dofs]) > 1.0)
    assert abs(data.joint("joint3").qacc[0]) < 1e-5


def test_pauses_are_not_simulated_across(tmp_path: Path) -> None:
    data = recording()
    keep = np.ones(len(data), dtype=bool)
    keep[900:1200] = False
    assert len(uniform_segments([data.select(keep)])) == 2
    found = simulated(files(tmp_path, "a"), files(tmp_path, "a"), data.select(keep))
    assert max(found.after.values()) < 1.0 + SCATTER


def test_a_simulation_that_diverges_is_infinitely_wrong(tmp_path: Path) -> None:
    broken = files(tmp_path, "broken")
    broken.mjcf.write_text(broken.mjcf.read_text().replace('name="joint2"', 'name="joint2" stiffness="-1e9"', 1))
    found = simulated(broken, files(tmp_path, "a"), recording(duration=2.0))
    assert found.before["joint2"] > 1e6
    assert np.isfinite(found.after["joint2"])


def test_what_cannot_be_simulated_says_why(tmp_path: Path) -> None:
    ok, data, noise = files(tmp_path, "a"), recording(duration=2.0), noise_example()
    floating = MeasurementModel(Robot(ARM, floating_base=True), (), [WrenchSensor("/plate", "world", "external")])
    touched = MeasurementModel(Robot(ARM), (), [WrenchSensor("/hand", "tool", "external")])
    still = with_values(data, position=np.zeros_like(data.position))
    for model, given, reason in (
        (floating, data, "floating base"),
        (touched, data, "external loads"),
        (MODEL, data.select(slice(0, 5)), "too short"),
        (MODEL, still, "no joint"),
    ):
        with pytest.raises(NotSimulatedError, match=reason):
            resimulate(model, ok, ok, [given], noise)


@pytest.mark.parametrize(
    ("text", "message"),
    [("<mujoco", "MuJoCo cannot read"), ("<mujoco/>", "unknown joint 'joint1'"), (None, "MuJoCo cannot read")],
)
def test_model_files_that_cannot_be_used_are_named(tmp_path: Path, text: str | None, message: str) -> None:
    model = ModelFiles(tmp_path / "model.xml", tmp_path / "model.yaml")
    if text is not None:
        model.mjcf.write_text(text)
    with pytest.raises(InputError, match=rf"model\.xml: .*{message}"):
        simulated(model, model, recording(duration=2.0))
    wrong = files(tmp_path, "wrong", [effect("effort_gain", "elbow", gain=2.0)])
    with pytest.raises(InputError, match=r"wrong\.yaml: unknown joint 'elbow'"):
        simulated(files(tmp_path, "other"), wrong, recording(duration=2.0))


def test_noise_is_the_remainder_at_the_size_of_the_floor() -> None:
    """Its colour and what channels share stay, its size becomes the floor's."""
    remainder = noise_example().values * 3.0
    remainder[5:9, 1], remainder[:, 8] = np.nan, np.nan
    trace = SimpleNamespace(
        stamps=np.arange(len(remainder)) * 10_000_000, measured=remainder + 7.0, after=np.full(remainder.shape, 7.0)
    )
    names = [channel.name for channel in MODEL.channels]
    found = ResidualNoise.of(cast(GapResult, SimpleNamespace(trace=trace, channels=tuple(names), floor=FLOOR)))
    assert found.period == pytest.approx(PERIOD)
    np.testing.assert_allclose(np.sqrt(np.nanmean(found.values[:, :8] ** 2, axis=0)), FLOOR[:8])
    np.testing.assert_allclose(found.values[:, 0], noise_example().values[:, 0])
    assert np.all(np.isnan(found.values[:, 8]))
    assert np.all(found.only(names).values[:, 8] == 0.0)


STIFFNESS = np.array([400.0, 600.0, 200.0])
DAMPING = np.array([20.0, 30.0, 5.0])
SCATTER_OF_NOISE = 0.15  # of a root mean square over the 20 s of noise below 8 Hz
CUTOFF = 8.0


def commands(samples: Samples, effort: FloatArray, seed: int = 5) -> Samples:
    """Set-points and feed-forward with which a controller of these gains asks for ``effort`` at this motion."""
    error_rate = 0.02 * motion(len(samples) * PERIOD, seed)[1]
    feedforward = 0.8 * effort
    error = (effort - feedforward - DAMPING * error_rate - 0.3) / STIFFNESS
    return with_values(
        samples, position=samples.position + error, velocity=samples.velocity + error_rate, effort=feedforward
    )


def commanded(before: ModelFiles, after: ModelFiles, data: Samples, wanted: Samples) -> Resimulated:
    return resimulate_closed_loop(MODEL, before, after, [data], [wanted], noise=noise_example(), cutoff=CUTOFF)


def test_in_closed_loop_a_right_model_needs_the_measured_efforts(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    found = commanded(files(tmp_path, "a"), files(tmp_path, "a"), recording(), commands(exact, exact.effort))
    assert found.after == found.before
    assert {**found.after} == pytest.approx(dict.fromkeys(JOINTS, 1.0), rel=SCATTER_OF_NOISE)
    (trace,) = found.efforts
    np.testing.assert_array_equal(trace.after, trace.before)


def test_in_closed_loop_a_wrong_one_needs_others_in_proportion(tmp_path: Path) -> None:
    ratios = []
    for stiffness in (2.0, 4.0):
        added, known = spring(stiffness)
        data = recording(added, noise=0.0, duration=8.0)
        after = files(tmp_path, "after", [known])
        found = commanded(files(tmp_path, "before"), after, data, commands(data, data.effort))
        assert max(found.after.values()) < 0.5
        ratios.append(found.before["joint2"])
    assert ratios[0] > 5.0
    assert ratios[1] / ratios[0] == pytest.approx(2.0, rel=0.1)


def test_friction_and_sensors_that_only_the_sidecar_says(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    friction = SECOND * stribeck(exact.position, exact.velocity, exact.acceleration)
    true = exact.effort + friction
    measured = recording().effort + friction
    measured[:, 2] = 1.2 * (measured[:, 2] + 0.4)
    known = [
        STRIBECK,
        effect("effort_gain", "joint3", gain=1.2),
        effect("effort_offset", "joint3", offset=0.4),
    ]
    data = with_values(exact, effort=measured)
    found = commanded(files(tmp_path, "before"), files(tmp_path, "after", known), data, commands(exact, true))
    assert min(found.before["joint2"], found.before["joint3"]) > 4.0
    assert max(found.after.values()) < 1.6


def test_a_delay_is_put_back(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    late = with_values(exact, effort=np.roll(exact.effort, 3, axis=0)).select(slice(10, -10))
    known = files(tmp_path, "after", [effect("effort_delay", delay=3 * PERIOD)])
    found = commanded(files(tmp_path, "before"), known, late, commands(exact, exact.effort).select(slice(10, -10)))
    assert min(found.before.values()) > 2.0
    assert max(found.after.values()) < 0.5


def test_a_joint_that_nobody_commands_follows_its_measured_motion(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    wanted = commands(exact, exact.effort)
    deaf = with_values(
        wanted,
        position=wanted.position * [0.0, 1.0, 1.0],
        velocity=wanted.velocity * [0.0, 1.0, 1.0],
        effort=wanted.effort * [0.0, 1.0, 1.0],
    )
    found = commanded(files(tmp_path, "a"), files(tmp_path, "a"), recording(), deaf)
    assert found.after == pytest.approx({"joint2": 1.0, "joint3": 1.0}, rel=SCATTER_OF_NOISE)


def test_what_cannot_be_simulated_in_closed_loop_says_why(tmp_path: Path) -> None:
    ok, exact = files(tmp_path, "a"), recording(noise=0.0)
    elsewhere = with_values(exact, stamps=exact.stamps + 1)
    with pytest.raises(NotSimulatedError, match="do not overlap in time"):
        commanded(ok, ok, exact, elsewhere)
    random = np.random.default_rng(0).normal(size=exact.position.shape)
    unrelated = with_values(exact, position=random, velocity=random, effort=np.full_like(random, np.nan))
    with pytest.raises(NotSimulatedError, match="cannot be reproduced from the commands"):
        commanded(ok, ok, exact, unrelated)
    floating = MeasurementModel(Robot(ARM, floating_base=True, cuts=["wrist_ft"]), (), MODEL.sensors)
    with pytest.raises(NotSimulatedError, match="floating base"):
        resimulate_closed_loop(floating, ok, ok, [exact], [exact], noise=noise_example(), cutoff=CUTOFF)


SPINNING = "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"


def test_a_run_that_diverges_leaves_no_file_and_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(SPINNING)
    data = mujoco.MjData(model)
    data.qvel[0] = 1e12
    mujoco.mj_step(model, data)
    assert sum(data.warning.number) == 1
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
