"""MuJoCo's robot obeys the equation of motion that pinocchio writes down for the planted truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.motion import FADE_IN, RunTrace
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import control_loop, record
from geomid_ros.simulation.robot import build_robot

from .conftest import Run

pytest.importorskip("mujoco")

EXACT = 1e-11  # N, N m: rounding, three orders above what was seen
MOVING = 0.03  # rad/s; below, MuJoCo's dry friction is not yet constant
QUICK = SimulationOptions(robot="arm3", duration=4.0, coulomb_friction=0.0)


def recorded(options: SimulationOptions) -> RunTrace:
    robot = build_robot(options)
    return record(robot, control_loop(robot, options), options)


def test_effort_is_the_inverse_dynamics_of_the_truth(run: Run) -> None:
    dry = run.trace.effort - run.independent.smooth_effort(run.trace)
    expected = run.independent.coefficients("coulomb_friction") * np.sign(run.trace.velocity)
    moving = np.abs(run.trace.velocity) > MOVING
    assert moving.mean() > 0.75
    np.testing.assert_allclose(dry[moving], expected[moving], rtol=0.0, atol=EXACT)
    assert np.all(np.abs(dry) <= run.independent.coefficients("coulomb_friction") + EXACT), "also near standstill"


def test_wrench_is_what_the_arm_applies_to_the_tool(run: Run) -> None:
    expected = run.independent.carried_wrench(run.trace, WRIST_FRAME, "tool")
    np.testing.assert_allclose(run.trace.wrench, expected, rtol=0.0, atol=EXACT)


def test_a_row_belongs_to_one_instant() -> None:
    """Neither effort nor acceleration leads or lags the motion: half a step of skew would show as 1e-2."""
    options = replace(QUICK, rate=2000.0)
    trace = recorded(options)
    step = 1.0 / options.rate
    smooth = np.abs(trace.time[2:-2] - FADE_IN) > 4 * step
    for values, rates in ((trace.velocity, trace.acceleration), (trace.position, trace.velocity)):
        slope = (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / (12.0 * step)
        np.testing.assert_allclose(slope[smooth], rates[2:-2][smooth], rtol=0.0, atol=2e-5)


def test_integration_has_converged() -> None:
    options = replace(QUICK, duration=1.0)
    coarse, fine = (recorded(replace(options, longest_step=step)) for step in (5e-4, 1e-4))
    np.testing.assert_allclose(coarse.position, fine.position, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(coarse.effort, fine.effort, rtol=0.0, atol=1e-4)


def test_robot_follows_its_motion_inside_its_limits(run: Run) -> None:
    for joint, position, velocity in zip(run.robot.joints, run.trace.position.T, run.trace.velocity.T, strict=True):
        assert joint.lower < position.min() < position.max() < joint.upper
        assert np.abs(velocity).max() < joint.velocity
