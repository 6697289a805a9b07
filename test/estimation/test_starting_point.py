"""What is known before the solve, against scipy on the raw rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from geomid_ros.errors import InputError
from geomid_ros.estimation.starting_point import (
    _non_negative,
    channel_sizes,
    first_sigmas,
    prior_parameters,
    prior_stds_of,
    scales_of_coefficients,
)
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.effects import identifiable, joint_of
from geomid_ros.model.effects.mounting import GravityTilt
from geomid_ros.model.effects.sensor_errors import EffortOffset
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REGIMES
from geomid_ros.types import BoolArray, FloatArray

from . import arms
from .arms import Case, arm

# The start is damped as if by a motion of 0.01 rad/s, which shifts well-excited coefficients by little.
DAMPING = 1e-2


def summary(case: Case, still: BoolArray | None = None) -> RowSummary:
    rows = case.model.rows(case.samples)
    regimes = 0 if still is None else (REGIMES - 1) * still
    return arms.summary(case.model, rows.coefficients, rows.targets, regimes)


def started(case: Case) -> FloatArray:
    return prior_parameters(case.model, summary(case), None)


def effects_of_joint(case: Case, joint: int) -> FloatArray:
    first = len(case.model.nominal_inertias)
    return np.array([first + k for k, c in enumerate(case.model.coefficients) if joint_of(c.place) == joint])


def test_effects_start_at_the_non_negative_fit_of_what_the_nominal_inertias_leave() -> None:
    case = arm("arm3", 1, seconds=8)
    rows, found = case.model.rows(case.samples), started(case)
    nominal = case.model.nominal_inertias
    np.testing.assert_array_equal(found[: len(nominal)], nominal)
    for joint in range(3):
        columns = effects_of_joint(case, joint)
        regressor = rows.coefficients[:, joint, columns]
        remainder = rows.targets[:, joint] - rows.coefficients[:, joint, : len(nominal)] @ nominal
        fitted, _ = nnls(np.column_stack([regressor, -np.ones(len(regressor))]), remainder)
        expected = np.append(fitted[:3], 0.0)  # an offset, an error of the sensor, is expected to be zero
        kept = (expected > 0.1) | (np.arange(4) == 3)
        np.testing.assert_allclose(found[columns][kept], expected[kept], rtol=DAMPING, atol=DAMPING)


def test_sigmas_are_those_of_the_noise() -> None:
    """Unbiased although many of the regressor's columns depend on each other."""
    case = arm("arm7", 0, noise=0.5)
    rows = summary(case)
    fast, *slower = np.split(first_sigmas(rows, case.model.dimension), REGIMES)
    np.testing.assert_allclose(fast, 0.5, rtol=0.06)
    for regime in slower:
        np.testing.assert_array_equal(regime, channel_sizes(rows, case.model.dimension))


def test_sigmas_have_a_floor_and_wait_for_enough_rows() -> None:
    case = arm("arm3", 0, noise=0.0)
    sizes = channel_sizes(summary(case), case.model.dimension)
    np.testing.assert_allclose(sizes, np.sqrt(np.mean(case.noiseless**2, axis=0)), rtol=1e-9)
    np.testing.assert_allclose(first_sigmas(summary(case), case.model.dimension)[:3], 1e-3 * sizes)
    few = replace(case, samples=case.samples.select(slice(0, 5)))
    expected = np.tile(channel_sizes(summary(few), case.model.dimension), REGIMES)
    np.testing.assert_array_equal(first_sigmas(summary(few), case.model.dimension), expected)


def test_a_given_prior_says_how_large_an_offset_is() -> None:
    case = arm("arm3", 0, seconds=2)
    given = np.full(case.model.dimension, np.nan)
    given[-1] = 0.7
    found = summary(case)
    spreads = prior_stds_of(
        case.model, case.model.manifold(scales_of_coefficients(case.model, found)[case.model.positives :]), given
    )
    np.testing.assert_array_equal(spreads[-3:], [EffortOffset.prior_std_fraction] * 2 + [0.2])
    assert prior_parameters(case.model, found, given)[-1] == 0.7


def test_a_tilt_is_expected_to_be_as_large_on_any_robot() -> None:
    """About zero, though a first fit beside links that are wrong finds another one."""
    case = arm("arm7", 0, seconds=2)
    model = MeasurementModel(case.model.robot, [*case.effects, identifiable()["gravity_tilt"]])
    found = summary(replace(case, model=model))
    scales = scales_of_coefficients(model, found)[model.positives :]
    stds = prior_stds_of(model, model.manifold(scales), None)[-2:]
    np.testing.assert_allclose(stds * scales[-2:], GravityTilt.default_prior_std)
    np.testing.assert_array_equal(prior_parameters(model, found, None)[-2:], 0.0)


def test_a_coefficients_scale_is_that_with_which_it_is_as_large_as_its_channel() -> None:
    """Of a real coefficient whose column is not one everywhere: whichever group its rows are in."""
    case = arm("arm3", 0, seconds=8)
    model = MeasurementModel(case.model.robot, [identifiable()["quadratic_friction"]])
    rows = model.rows(case.samples)
    halves = np.arange(len(case.samples))[:, None] % 2 == np.zeros(3)
    for still in (np.zeros_like(halves), halves):
        found = summary(replace(case, model=model), still)
        expected = [
            np.sqrt(np.mean(rows.targets[:, joint] ** 2) / np.mean(rows.coefficients[:, joint, 30 + joint] ** 2))
            for joint in range(3)
        ]
        np.testing.assert_allclose(scales_of_coefficients(model, found)[model.positives :], expected, rtol=1e-9)


def test_of_several_channels_that_counts_which_a_coefficient_shows_most_in() -> None:
    """What hardly shows in a channel, as the offset of a leg's motor in the force along its axis, may not be as large
    as would be seen there."""
    case = arm("arm3", 0, seconds=8)
    model = MeasurementModel(case.model.robot, [identifiable()["coupled_viscous_friction"]])
    rows = model.rows(case.samples)
    rows.targets[:, 1] *= 100.0
    found = arms.summary(model, rows.coefficients, rows.targets)
    first = len(model.nominal_inertias)
    shown = (
        np.sqrt(np.mean(rows.coefficients[:, :, first:] ** 2, axis=0)) / channel_sizes(found, model.dimension)[:, None]
    )
    np.testing.assert_allclose(scales_of_coefficients(model, found), 1.0 / np.max(shown, axis=0), rtol=1e-9)


def test_what_is_known_of_the_prior_replaces_what_is_not() -> None:
    case = arm("arm3", 0, seconds=4)
    known = np.full(case.model.dimension, np.nan)
    known[10:20] = case.truth[10:20]
    known[31] = 0.7
    found = prior_parameters(case.model, summary(case), known)
    unknown = np.isnan(known)
    np.testing.assert_array_equal(found[~unknown], known[~unknown])
    np.testing.assert_array_equal(found[:10], case.model.nominal_inertias[:10])
    # The effects are fitted to what the known inertias leave, which is less.
    assert abs(found[33] - case.truth[33]) < abs(started(case)[33] - case.truth[33])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda known: known[:-1], r"\(41,\)"),
        (lambda known: known * np.where(np.arange(42) < 10, -1.0, 1.0), "link1"),
        (lambda known: known * np.where(np.arange(42) == 31, 0.0, 1.0), "viscous_friction of joint 'joint2'"),
    ],
)
def test_a_prior_that_cannot_be_is_refused(change: object, named: str) -> None:
    case = arm("arm3", 0, seconds=1)
    with pytest.raises(InputError, match=named):
        prior_parameters(case.model, summary(case), change(case.truth))


def test_non_negative_least_squares_are_those_of_scipy() -> None:
    """Of columns of very different sizes, some of them nearly alike."""
    rng = np.random.default_rng(1)
    regressor = rng.normal(size=(60, 12)) * 10.0 ** rng.uniform(-3.0, 3.0, size=12)
    regressor[:, 3] = regressor[:, 4] + 1e-4 * np.linalg.norm(regressor[:, 4]) * rng.normal(size=60)
    targets = regressor @ rng.normal(size=12) + rng.normal(size=60)
    expected, least = nnls(regressor, targets)
    columns = np.column_stack([regressor, targets])
    found = _non_negative(columns.T @ columns)
    assert np.all(found >= 0.0)
    assert np.linalg.norm(regressor @ found - targets) == pytest.approx(least, rel=1e-9)
    np.testing.assert_allclose(regressor @ found, regressor @ expected, rtol=0.0, atol=1e-6 * np.linalg.norm(targets))
