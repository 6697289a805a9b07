"""Gains of the joints' drives: what remains proportional to the links' load when the links are fitted."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import estimate
from geomid_ros.model.effects import DriveGain
from geomid_ros.types import FloatArray

from .arms import Case, Truth, arm, efforts, identifier, solved

NOISE = 0.05
PLANTED = np.array([1.04, 0.98, 1.07, 0.95, 1.02, 1.05, 0.93])


def loads(case: Case) -> FloatArray:
    """What the true links need ``(N, joints)``, by RNEA."""
    return efforts(case.model.robot, Truth(case.true.links, {}), case.samples)


def with_gains(case: Case) -> Case:
    planted = PLANTED[: case.samples.effort.shape[1]]
    return case.with_efforts(case.samples.effort + (planted - 1.0) * loads(case))


def beside_true_links(case: Case) -> Estimate:
    """The estimate of the samples with a prior that knows the links, and nothing of the effects."""
    first = len(case.model.nominal_inertias)
    prior = np.append(case.truth[:first], np.full(len(case.truth) - first, np.nan))
    stds = np.full(len(case.model.body_names), 1e-5)
    return estimate(case.model, identifier(case).snapshot(), prior=prior, prior_stds=stds)


def gains_of(estimate: Estimate) -> FloatArray:
    found = [effect for effect in estimate.effects if effect.name == DriveGain.name]
    return np.array([[effect.value, effect.std] for effect in found]).T


@pytest.mark.parametrize("name", ["arm3", "arm7"])
def test_gains_are_those_of_a_regression_on_the_load(name: str) -> None:
    """Least squares of each joint alone, on the load by RNEA and the columns of its effects, beside true links."""
    case = with_gains(arm(name, 0, noise=NOISE))
    found = beside_true_links(case)
    (std,) = DriveGain.default_prior_std
    v, load = case.samples.velocity, loads(case)
    for joint in range(load.shape[1]):
        columns = [load[:, joint], v[:, joint], np.tanh(v[:, joint] / 0.02), case.samples.acceleration[:, joint]]
        regressor = np.column_stack([*columns, np.ones(len(v))])
        prior = np.array([[NOISE / std, 0.0, 0.0, 0.0, 0.0]])
        target = np.append(case.samples.effort[:, joint] - load[:, joint], 0.0)
        expected = np.linalg.lstsq(np.concatenate([regressor, prior]), target, rcond=None)[0]
        assert found.predictor.drive_gains[joint] - 1.0 == pytest.approx(expected[0], abs=2e-3), joint
    values, stds = gains_of(found)
    np.testing.assert_array_equal(values, found.predictor.drive_gains)
    assert np.all(np.abs(values - PLANTED[: len(values)]) < 4.0 * stds + 2e-3)
    assert np.all(stds <= std)


def test_links_do_not_depend_on_gains_and_predictions_do() -> None:
    case = arm("arm3", 1, noise=NOISE)
    found = solved(with_gains(case))
    first = len(case.model.nominal_inertias)
    np.testing.assert_array_equal(found.predictor.parameters[:first], found.parameters[:first])
    fresh = with_gains(case.fresh(2))
    errors = [
        np.sqrt(np.mean(np.subtract(*fresh.model.predict(fresh.samples, *model)) ** 2, axis=0))
        for model in (found.predictor, (found.parameters,))
    ]
    assert np.sum(errors[0]) < np.sum(errors[1])
    own = np.subtract(*case.model.predict(with_gains(case).samples, *found.predictor))
    np.testing.assert_allclose(np.sqrt(np.mean(own**2, axis=0)), found.rms, rtol=1e-6)


def test_an_exact_drive_has_no_gain() -> None:
    values, stds = gains_of(solved(arm("arm3", 2, noise=NOISE)))
    assert np.all(np.abs(values - 1.0) < 3.0 * stds)


def test_there_are_none_beside_links_that_are_given() -> None:
    """What these need is not known apart."""
    found = solved(arm("arm3", 0, noise=NOISE, links=("link3",)))
    assert not np.any(found.predictor.drive_gains != 1.0)
    np.testing.assert_array_equal(found.predictor.parameters, found.parameters)


def test_rows_of_a_model_with_gains_are_its_predictions() -> None:
    case = arm("arm7", 0)
    gains = PLANTED[: len(case.model.channels)]
    measured, predicted = case.model.predict(case.samples, case.truth, gains)
    again, rows = case.model.with_drive_gains(gains).predict(case.samples, case.truth)
    np.testing.assert_array_equal(measured, again)
    np.testing.assert_allclose(predicted, rows, rtol=1e-9, atol=1e-9)
    some = arm("arm7", 0, links=("link5",)).model  # the others have the URDF's inertias
    nothing = np.append(some.nominal_inertias, np.zeros(len(some.coefficients)))
    load = some.predicted_efforts(case.samples, nothing)
    scaled = some.with_drive_gains(gains).predicted_efforts(case.samples, nothing)
    np.testing.assert_allclose(scaled, gains * load, rtol=1e-9, atol=1e-9)
    several = case.model.predict(case.samples, np.column_stack([case.truth] * 2), np.column_stack([gains, gains**0]))
    np.testing.assert_allclose(several[1][:, :, 0], predicted)
    np.testing.assert_allclose(several[1][:, :, 1], case.model.predict(case.samples, case.truth)[1])
