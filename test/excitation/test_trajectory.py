"""Motions by points, and the file that has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.files.trajectories import read_trajectory

from .motions import Motion, lively

JOINTS = ("shoulder", "elbow")


def test_a_motion_of_degree_five_is_met_everywhere(tmp_path: Path) -> None:
    """By three points: a quintic is determined by what two of them say of it."""
    random = np.random.default_rng(0)
    motion = Motion(JOINTS, tuple(Polynomial(random.normal(0.0, 1.0, 6)) for _ in JOINTS), 3.0)
    trajectory = read_trajectory(motion.write(tmp_path / "trajectory.yaml", 3))
    times = np.linspace(0.0, 3.0, 50)
    for order, states in enumerate(trajectory.states(times)):
        np.testing.assert_allclose(states, motion.rows(times, order), atol=1e-6)
    positions, velocities = np.moveaxis([trajectory.at(time) for time in times.tolist()], 1, 0)
    np.testing.assert_allclose(positions, motion.rows(times), atol=1e-8)
    np.testing.assert_allclose(velocities, motion.rows(times, 1), atol=1e-8)


def test_at_another_speed_the_path_is_the_same(tmp_path: Path) -> None:
    """q(s t), s q', s^2 q''."""
    motion = lively(JOINTS, 5.0, 0.3)
    trajectory = read_trajectory(motion.write(tmp_path / "trajectory.yaml", 100))
    slow = trajectory.at_speed(0.2)
    assert slow.duration == pytest.approx(25.0)
    np.testing.assert_allclose(slow.velocities, 0.2 * trajectory.velocities)
    for time in np.linspace(0.0, 5.0, 37).tolist():
        np.testing.assert_allclose(slow.at(5.0 * time)[0], trajectory.at(time)[0], atol=1e-9)
        np.testing.assert_allclose(slow.at(5.0 * time)[1], 0.2 * trajectory.at(time)[1], atol=1e-9)
    np.testing.assert_allclose(trajectory.speeds, np.abs(motion.rows(trajectory.times, 1)).max(axis=0), rtol=1e-8)


FORMS = [
    MotionForm(period=10.0),
    MotionForm(period=5.0, slow_fraction=0.0, repeats=3),
    MotionForm(period=20.0, slow_fraction=0.5, repeats=2),
]


def some(form: MotionForm) -> ExcitingMotion:
    return ExcitingMotion(form, np.array([0.3, -1.0]), np.random.default_rng(0).standard_normal((form.size, 2)))


@pytest.mark.parametrize("form", FORMS)
def test_periods_begin_and_end_at_rest_and_each_derivative_is_that_of_the_one_before(form: MotionForm) -> None:
    step = 1e-5
    times = np.random.default_rng(1).uniform(0.1, form.period - 0.1, 200)
    ahead, behind, exact = (some(form).at(times + shift) for shift in (step, -step, 0.0))
    numeric = (ahead[:-1] - behind[:-1]) / (2.0 * step)
    scale = np.max(np.abs(exact[1:]), axis=(1, 2), keepdims=True)
    assert np.max(np.abs(numeric - exact[1:]) / scale) < 1e-4
    ends = np.arange(form.repeats + 1) * form.period
    position, velocity, acceleration, _ = some(form).at(np.concatenate([ends + 1e-9, ends - 1e-9]))
    assert np.allclose(position, some(form).start, atol=1e-8)
    assert np.max(np.abs(velocity)) < 1e-7
    assert np.max(np.abs(acceleration)) < 1e-6


@pytest.mark.parametrize("form", [FORMS[0], FORMS[2]])
def test_slow_runs_have_stretches_of_constant_speed_both_ways(form: MotionForm) -> None:
    begin = (1.0 - form.slow_fraction) * form.period
    times = np.linspace(begin, form.period, 5000)
    _, velocity, acceleration, jerk = form.basis(times)[:, :, form.waves :]
    steady = (np.abs(acceleration) < 1e-9) & (np.abs(jerk) < 1e-9) & (np.abs(velocity) > 0.0)
    for own, speed in zip(steady.T, velocity.T, strict=True):
        assert np.any(own & (speed > 0.0))
        assert np.any(own & (speed < 0.0))
        assert len(np.unique(np.round(np.abs(speed[own]), 9))) == 1
    assert np.mean(np.any(steady, axis=1)) > 0.3
