"""A base that is not level: columns of gravity's direction, and tilts that are found beside the links."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.estimation.estimate import EffectEstimate, Estimate
from geomid_ros.estimation.estimator import _size
from geomid_ros.estimation.starting_point import first_fit
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.dynamics import InverseDynamics
from geomid_ros.model.effects import Quantity, identifiable
from geomid_ros.model.effects.mounting import GravityTilt
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

from .arms import Case, Motion, Truth, arm, efforts, identifier, shipped, summary

TILT = np.array([0.02, -0.03])
DOWN = np.array([0.0, 0.0, -9.81])


def gravity(tilt: FloatArray) -> FloatArray:
    """In the frame of a base that is turned by a rotation vector."""
    return pin.exp3(np.append(tilt, 0.0)).T @ DOWN


def with_tilt(case: Case, tilt: FloatArray) -> Case:
    """The same robot and motion on a tilted base, and a model that may have a tilt."""
    moving = Motion(case.samples.position, case.samples.velocity, case.samples.acceleration)
    more = efforts(case.model.robot, case.true, moving, gravity(tilt).tolist()) - case.noiseless
    model = MeasurementModel(case.model.robot, case.effects, candidates=[identifiable()["gravity_tilt"]])
    return Case(model, case.with_efforts(case.samples.effort + more).samples, case.noiseless, case.truth, case.true)


def tilt_of(estimate: Estimate) -> FloatArray:
    """Values and standard deviations ``(2, 2)``; zero where there is none."""
    found = np.zeros((2, 2))
    for effect in estimate.effects:
        if effect.name == "gravity_tilt":
            (name,) = effect.parameters
            found[:, ("tilt_x", "tilt_y").index(name)] = effect.value, effect.std
    return found


@pytest.mark.parametrize("name", ["arm3", "arm7"])
def test_its_columns_are_the_change_of_inverse_dynamics(name: str) -> None:
    """Beside the bodies that are known beforehand, with gains of the drives."""
    case = with_tilt(arm(name, 0, seconds=0.5), np.zeros(2))
    gains = np.linspace(0.9, 1.2, case.samples.effort.shape[1])
    model = case.model.with_known_loads(
        np.append(case.true.links.ravel(), np.full(len(case.model.coefficients), np.nan))
    )
    columns = model.with_drive_gains(gains).rows(case.samples).coefficients[:, :, -2:]
    moving = Motion(case.samples.position, case.samples.velocity, case.samples.acceleration)
    links = Truth(case.true.links, {})
    for column, step in zip(np.moveaxis(columns, 2, 0), 1e-4 * np.eye(2), strict=True):
        ahead, behind = (efforts(model.robot, links, moving, gravity(sign * step).tolist()) for sign in (1.0, -1.0))
        np.testing.assert_allclose(column, gains * (ahead - behind) / 2e-4, atol=1e-6)


def test_a_wrench_sensor_feels_it_too() -> None:
    """The column is the derivative of what the URDF's bodies do to a sensor in the wrist."""
    sensor = WrenchSensor("/wrist", "wrist_ft", "mounted", ("fx", "tz", "fy"))
    model = MeasurementModel(Robot(shipped("arm3"), cuts=["wrist_ft"]), [identifiable()["gravity_tilt"]], [sensor])
    case = arm("arm3", 0, seconds=0.5)
    measured = case.samples.select(slice(None))
    measured = type(measured)(**{**measured.arrays, "wrenches": np.zeros((len(measured), 1, 6))})
    columns = model.rows(measured).coefficients[:, :, -2:]
    for channel in model.channels:
        assert np.all(np.isin([model.dimension - 2, model.dimension - 1], channel.columns)), channel.name
    for column, step in zip(np.moveaxis(columns, 2, 0), 1e-4 * np.eye(2), strict=True):
        ahead, behind = (
            model.with_gravity(gravity(sign * step)).rows(measured).coefficients @ model.nominal_parameters
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(column, (ahead - behind) / 2e-4, atol=1e-6)


def test_its_slopes_are_those_of_turned_gravity() -> None:
    """Of a large tilt, too."""
    tilt, steps = np.array([0.4, -0.7]), 1e-6 * np.eye(2)
    expected = np.array([(gravity(tilt + step) - gravity(tilt - step)) / 2e-6 for step in steps]).T
    np.testing.assert_allclose(GravityTilt().slopes(DOWN, tilt), expected, atol=1e-7)


def test_before_the_solve_it_ties_no_joints_together() -> None:
    """Effects of joints start where they do without it: those of each joint are fitted alone, of however many."""
    case = with_tilt(arm("arm3", 0, seconds=2), TILT)
    rows, tilts = case.model.rows(case.samples), 2
    links = len(case.model.nominal_inertias)
    without = MeasurementModel(case.model.robot, case.effects)
    both = first_fit(case.model, summary(case.model, rows.coefficients, rows.targets), None)
    alone = first_fit(without, summary(without, rows.coefficients[:, :, :-tilts], rows.targets), None)
    np.testing.assert_allclose(both[links:-tilts], alone[links:], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(both[-tilts:], 0.0)


def test_a_tilt_is_found_beside_wrong_links() -> None:
    """By its columns at the URDF's bodies to a tenth or so; at the bodies that were found, to its own deviation."""
    case = with_tilt(arm("arm7", 0), TILT)
    first = identifier(case).solve()
    value, _ = tilt_of(first)
    assert np.all(np.abs(value - TILT) < 0.15 * np.linalg.norm(TILT))
    links = np.append(first.parameters[: case.true.links.size], np.full(len(case.model.coefficients), np.nan))
    again = Case(case.model.with_known_loads(links), case.samples, case.noiseless, case.truth, case.true)
    value, std = tilt_of(identifier(again).solve())
    assert np.all(np.abs(value - TILT) < 4.0 * std)
    assert np.all(std < 0.2 * np.linalg.norm(TILT))


@pytest.mark.parametrize(("value", "std"), [(0.02, 0.002), (-0.05, 0.036)])
def test_its_size_is_that_of_the_posterior(value: float, std: float) -> None:
    """A product of two normal densities: of what is expected, and of what the data say."""
    coefficient, expected = with_tilt(arm("arm3", 0), TILT).model.coefficients[-2], GravityTilt.default_prior_std[0]
    variance = 1.0 / (expected**-2 + std**-2)
    found = EffectEstimate(
        name=GravityTilt.name,
        joint="",
        parameters={"tilt_x": Quantity(value, np.sqrt(variance), "rad")},
        from_data=1.0 - variance / expected**2,
    )
    assert _size(coefficient, found) == pytest.approx(abs(variance * value / std**2) / np.sqrt(variance))


def test_a_tilt_of_many_degrees_is_none() -> None:
    """A base that is tilted so far is so on purpose, and gravity is given: here something else passes for a tilt."""
    few, many = (tilt_of(identifier(with_tilt(arm("arm3", 0), np.array([tilt, 0.0]))).solve()) for tilt in (0.05, 0.08))
    assert few[0, 0] > 0.04
    assert not np.any(many[:, 0])


def test_of_a_level_base_there_is_none() -> None:
    assert not np.any(tilt_of(identifier(with_tilt(arm("arm7", 2), np.zeros(2))).solve()))


def test_a_message_is_predicted_under_tilted_gravity() -> None:
    case = with_tilt(arm("arm7", 0, seconds=0.5), np.zeros(2))
    parameters = np.append(case.truth, TILT)
    states = np.array([case.samples.position, case.samples.velocity, case.samples.acceleration])
    expected = efforts(case.model.robot, case.true, Motion(*states), gravity(TILT).tolist())
    np.testing.assert_allclose(InverseDynamics(case.model, parameters)(states), expected, atol=1e-9)
