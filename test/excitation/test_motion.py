"""The form of motions: exact derivatives, rest at the ends, repeats, constant speeds."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.excitation.motion import ExcitingMotion, MotionForm

FORMS = [
    MotionForm(period=10.0),
    MotionForm(period=5.0, slow_share=0.0, repeats=3),
    MotionForm(period=20.0, slow_share=0.5, repeats=2),
]


def some(form: MotionForm) -> ExcitingMotion:
    return ExcitingMotion(form, np.array([0.3, -1.0]), np.random.default_rng(0).standard_normal((form.size, 2)))


@pytest.mark.parametrize("form", FORMS)
def test_each_derivative_is_that_of_the_one_before(form: MotionForm) -> None:
    step = 1e-5
    times = np.random.default_rng(1).uniform(0.1, form.period - 0.1, 200)
    ahead, behind, exact = (some(form).at(times + shift) for shift in (step, -step, 0.0))
    numeric = (ahead[:-1] - behind[:-1]) / (2.0 * step)
    scale = np.max(np.abs(exact[1:]), axis=(1, 2), keepdims=True)
    assert np.max(np.abs(numeric - exact[1:]) / scale) < 1e-4


@pytest.mark.parametrize("form", FORMS)
def test_periods_begin_and_end_at_rest(form: MotionForm) -> None:
    ends = np.arange(form.repeats + 1) * form.period
    near = np.concatenate([ends + 1e-9, ends - 1e-9])
    position, velocity, acceleration, _ = some(form).at(near)
    assert np.allclose(position, some(form).start, atol=1e-8)
    assert np.max(np.abs(velocity)) < 1e-7
    assert np.max(np.abs(acceleration)) < 1e-6


@pytest.mark.parametrize("form", [FORMS[0], FORMS[2]])
def test_slow_runs_have_stretches_of_constant_speed_both_ways(form: MotionForm) -> None:
    begin = (1.0 - form.slow_share) * form.period
    times = np.linspace(begin, form.period, 5000)
    _, velocity, acceleration, jerk = form.basis(times)[:, :, form.waves :]
    steady = (np.abs(acceleration) < 1e-9) & (np.abs(jerk) < 1e-9) & (np.abs(velocity) > 0.0)
    for own, speed in zip(steady.T, velocity.T, strict=True):
        assert np.any(own & (speed > 0.0))
        assert np.any(own & (speed < 0.0))
        assert len(np.unique(np.round(np.abs(speed[own]), 9))) == 1
    assert np.mean(np.any(steady, axis=1)) > 0.3
