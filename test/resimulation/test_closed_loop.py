"""A whole recording from its commands: the controller is found, a right model needs the measured efforts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from files.effects import effect
from model.robots import with_values

from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import NotSimulatedError, Resimulated, resimulate_closed_loop
from geomid_ros.resimulation.written_robot import load_mujoco
from geomid_ros.types import FloatArray

from .recordings import ARM, JOINTS, MODEL, PERIOD, files, motion, noise_example, recording

STIFFNESS = np.array([400.0, 600.0, 200.0])
DAMPING = np.array([20.0, 30.0, 5.0])
SCATTER = 0.15  # of a root mean square over the 20 s of noise below 8 Hz
CUTOFF = 8.0


def commands(samples: Samples, effort: FloatArray, seed: int = 5) -> Samples:
    """Set-points and feed-forward with which a controller of these gains asks for ``effort`` at this motion."""
    error_rate = 0.02 * motion(len(samples) * PERIOD, seed)[1]
    feedforward = 0.8 * effort
    error = (effort - feedforward - DAMPING * error_rate - 0.3) / STIFFNESS
    return with_values(
        samples, position=samples.position + error, velocity=samples.velocity + error_rate, effort=feedforward
    )


def simulated(before: ModelFiles, after: ModelFiles, data: Samples, wanted: Samples) -> Resimulated:
    return resimulate_closed_loop(MODEL, before, after, [data], [wanted], noise=noise_example(), cutoff=CUTOFF)


def test_a_right_model_needs_the_measured_efforts(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    found = simulated(files(tmp_path, "a"), files(tmp_path, "a"), recording(), commands(exact, exact.effort))
    assert found.after == found.before
    assert {**found.after} == pytest.approx(dict.fromkeys(JOINTS, 1.0), rel=SCATTER)
    (trace,) = found.efforts
    np.testing.assert_array_equal(trace.after, trace.before)


def test_a_wrong_one_needs_others_in_proportion(tmp_path: Path) -> None:
    ratios = []
    for stiffness in (2.0, 4.0):

        def spring(position: FloatArray, *_: FloatArray, stiffness: float = stiffness) -> FloatArray:
            return stiffness * (position - 0.3) * np.array([0.0, 1.0, 0.0])

        data = recording(spring, noise=0.0)
        known = effect("spring", "joint2", stiffness=stiffness, equilibrium=0.3)
        after = files(tmp_path, "after", [known])
        found = simulated(files(tmp_path, "before"), after, data, commands(data, data.effort))
        assert max(found.after.values()) < 0.5
        ratios.append(found.before["joint2"])
    assert ratios[0] > 5.0
    assert ratios[1] / ratios[0] == pytest.approx(2.0, rel=0.1)


def test_friction_and_sensors_that_only_the_sidecar_says(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    velocity = exact.velocity[:, 1]
    friction = np.zeros_like(exact.effort)
    friction[:, 1] = np.sign(velocity) * (0.5 + 0.5 * np.exp(-((velocity / 0.3) ** 2)))
    true = exact.effort + friction
    measured = recording().effort + friction
    measured[:, 2] = 1.2 * (measured[:, 2] + 0.4)
    known = [
        effect("stribeck_friction", "joint2", level=0.5, excess=0.5, speed=0.3),
        effect("effort_gain", "joint3", gain=1.2),
        effect("effort_offset", "joint3", offset=0.4),
    ]
    data = with_values(exact, effort=measured)
    found = simulated(files(tmp_path, "before"), files(tmp_path, "after", known), data, commands(exact, true))
    assert min(found.before["joint2"], found.before["joint3"]) > 4.0
    assert max(found.after.values()) < 1.6


def test_a_delay_is_put_back(tmp_path: Path) -> None:
    exact = recording(noise=0.0)
    late = with_values(exact, effort=np.roll(exact.effort, 3, axis=0)).select(slice(10, -10))
    known = files(tmp_path, "after", [effect("effort_delay", delay=3 * PERIOD)])
    found = simulated(files(tmp_path, "before"), known, late, commands(exact, exact.effort).select(slice(10, -10)))
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
    found = simulated(files(tmp_path, "a"), files(tmp_path, "a"), recording(), deaf)
    assert found.after == pytest.approx({"joint2": 1.0, "joint3": 1.0}, rel=SCATTER)


def test_what_cannot_be_simulated_says_why(tmp_path: Path) -> None:
    ok, exact = files(tmp_path, "a"), recording(noise=0.0)
    elsewhere = with_values(exact, stamps=exact.stamps + 1)
    with pytest.raises(NotSimulatedError, match="do not overlap in time"):
        simulated(ok, ok, exact, elsewhere)
    random = np.random.default_rng(0).normal(size=exact.position.shape)
    unrelated = with_values(exact, position=random, velocity=random, effort=np.full_like(random, np.nan))
    with pytest.raises(NotSimulatedError, match="cannot be reproduced from the commands"):
        simulated(ok, ok, exact, unrelated)
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
