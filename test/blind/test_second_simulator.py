"""The bench's two simulators obey the same equations: Drake and MuJoCo agree at any state, effect by effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind import drake_robot
from benchmarks.blind.drake_robot import DrakeRobot
from geomid_ros.simulation import EFFECTS, WRIST_FRAME, Hidden, SimulationOptions
from geomid_ros.simulation.robot import build_robot

pytestmark = [
    pytest.mark.skipif(not drake_robot.available(), reason="needs Drake: pip install -r requirements-bench.txt"),
]
OPTIONS = SimulationOptions(robot="arm7", wrench_frame=WRIST_FRAME)


@pytest.mark.parametrize("effect", EFFECTS)
def test_the_same_accelerations_and_wrench(effect: str) -> None:
    pytest.importorskip("mujoco")
    options = replace(OPTIONS, hide=(Hidden(effect),))
    mujoco, drake = build_robot(options).plant, build_robot(options, DrakeRobot).plant
    assert mujoco.joints == drake.joints
    np.testing.assert_array_equal(mujoco.driven, drake.driven)
    rng = np.random.default_rng(1)
    for _ in range(5):
        position = rng.uniform(-0.35, 0.25, len(mujoco.at_rest(np.zeros(7))[0]))
        velocity = rng.choice([-1.0, 1.0], len(position)) * rng.uniform(1.0, 1.5, len(position))
        effort = rng.uniform(-5.0, 5.0, 7)
        one, other = (plant.acceleration(position, velocity, effort) for plant in (mujoco, drake))
        scale = np.abs(one).max()
        tolerance = 1e-9 if not effect.endswith("friction") or effect == "viscous_friction" else 1e-4
        np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance * scale)
        np.testing.assert_allclose(mujoco.wrench(), drake.wrench(), rtol=0.0, atol=1e3 * tolerance * scale)


@pytest.mark.parametrize("effect", ["joint_elasticity", "backlash", "spring"])
def test_the_same_rest(effect: str) -> None:
    pytest.importorskip("mujoco")
    options = replace(OPTIONS, hide=(Hidden(effect, "joint2"),))
    mujoco, drake = build_robot(options).plant, build_robot(options, DrakeRobot).plant
    for one, other in zip(mujoco.at_rest(np.full(7, 0.1)), drake.at_rest(np.full(7, 0.1)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(mujoco.inertia_matrix(one), drake.inertia_matrix(one), rtol=1e-9, atol=1e-12)
