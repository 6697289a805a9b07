"""The problem linearised at a total model: planted robots whose effects are known leave nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.gap.candidates import EffectTerm
from geomid_ros.gap.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import Records
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import Point
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior
from geomid_ros.inference.prior import Prior
from geomid_ros.model.effects import AtJoint, Effect, OnRobot
from geomid_ros.model.effects.friction import LoadFriction, ViscousFriction
from geomid_ros.model.effects.mounting import GravityTilt
from geomid_ros.model.effects.sensor_errors import EffortDelay, EffortGain, EffortOffset
from geomid_ros.model.samples import Samples

from . import planted
from .test_verdict import PAYLOAD

MODEL = planted.model()
INERTIAS = planted.true_inertias(3, 0.2)
RIGID = planted.rigid(INERTIAS)
SECONDS = 10.0
VISCOUS = EffectTerm(ViscousFriction(), AtJoint(1))
OFFSET = EffectTerm(EffortOffset(), AtJoint(2))
GAIN = EffectTerm(EffortGain(), AtJoint(1))
DELAY = EffectTerm(EffortDelay(), OnRobot())
TILT = tuple(EffectTerm(GravityTilt(), OnRobot(), index) for index in range(2))


def exact(seed: int = 3) -> Samples:
    """Without noise."""
    return planted.recording(RIGID, seed, SECONDS, noise=0.0)


def said(values: dict[EffectTerm, float]) -> JointFit:
    """The planted robot with these coefficients, as if it were a fit."""
    known = np.array(list(values.values()))
    return fit_of_prior(
        Prior(
            inertias=INERTIAS.ravel(),
            prior_std=0.2,
            terms=tuple(values),
            values=known,
            prior_stds=np.ones(len(known)),
            certainty=4.0,
        )
    )


def residual(samples: Samples, at: dict[EffectTerm, float], found: dict[EffectTerm, float]) -> np.ndarray:
    """Of a model with the coefficients ``found``, linearised at others."""
    problem = LinearisedProblem.at(MODEL, Records.make([samples], planted.CUTOFF), said(at))
    return problem.residual(said(found))


def with_efforts(samples: Samples, scale: Sequence[float], joints: Sequence[float], offset: Sequence[float]) -> Samples:
    """Efforts times ``scale``, after friction and offsets of each joint were added."""
    whole = samples.effort + np.array(joints) * samples.velocity + np.array(offset)
    return replace(samples, effort=np.array(scale) * whole)


def test_what_a_model_says_of_everything_leaves_nothing() -> None:
    samples = with_efforts(exact(), [1.0, 1.0, 1.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.7])
    values: dict[EffectTerm, float] = {VISCOUS: 0.4, OFFSET: 0.7}
    np.testing.assert_allclose(residual(samples, values, values), 0.0, atol=1e-9)
    less = residual(samples, values, {VISCOUS: 0.1, OFFSET: 0.2})
    expected = np.array([0.0, 0.3, 0.0]) * Records.make([samples], planted.CUTOFF).samples.velocity + [0.0, 0.0, 0.5]
    np.testing.assert_allclose(less, expected, atol=1e-9)


@pytest.mark.parametrize("at", [0.0, 0.1, 0.25, -0.3])
def test_a_gain_is_the_whole_gain_wherever_it_is_linearised(at: float) -> None:
    """It scales all that is at its joint; of what a model with another gain predicts it is a column there."""
    samples = with_efforts(exact(), [1.0, 1.25, 1.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.0])
    values: dict[EffectTerm, float] = {VISCOUS: 0.4, GAIN: 0.25}
    np.testing.assert_allclose(residual(samples, {VISCOUS: 0.4, GAIN: at}, values), 0.0, atol=1e-9)


def test_a_gain_that_is_built_in_scales_all_columns_but_its_own() -> None:
    samples = exact()
    problem = LinearisedProblem.at(MODEL, Records.make([samples], planted.CUTOFF), said({GAIN: 0.25}))
    columns = problem.columns((VISCOUS, OFFSET, GAIN))
    np.testing.assert_allclose(columns[VISCOUS][1], 1.25 * problem.records.samples.velocity[:, 1])
    np.testing.assert_allclose(columns[OFFSET][2], 1.0)
    plain = LinearisedProblem.at(MODEL, problem.records, said({})).rows
    np.testing.assert_allclose(problem.rows.coefficients, np.array([1.0, 1.25, 1.0])[:, None] * plain.coefficients)
    np.testing.assert_allclose(columns[GAIN][1], problem.situation.predicted[:, 1])


def test_rows_are_made_once_for_a_model_and_kept_for_one() -> None:
    """They are as large as all else together."""
    records, tilted = Records.make([exact()], planted.CUTOFF), MODEL.with_gravity(np.array([0.0, 1.0, -9.7]))
    rows = records.rows(MODEL)
    assert records.rows(MODEL) is rows
    assert not rows.coefficients.flags.writeable
    assert records.rows(tilted) is not rows
    assert records.rows(MODEL) is not rows


@pytest.mark.parametrize(("at", "share"), [(0.03, 1e-4), (0.027, 3e-3), (0.0, 0.1)])
def test_a_tilt_is_the_whole_tilt_up_to_second_order(at: float, share: float) -> None:
    gravity = pin.exp3(np.array([0.03, 0.0, 0.0])).T @ MODEL.robot.gravity
    tilted = planted.recording(planted.rigid(INERTIAS, gravity), 3, SECONDS, noise=0.0)
    values: dict[EffectTerm, float] = {TILT[0]: 0.03, TILT[1]: 0.0}
    left = residual(tilted, {TILT[0]: at, TILT[1]: 0.0}, values)
    straight = residual(tilted, {}, {})
    assert np.linalg.norm(left) < share * np.linalg.norm(straight)


@pytest.mark.parametrize(("at", "share"), [(0.005, 1e-2), (0.004, 0.02), (0.0, 0.1)])
def test_a_delay_is_the_whole_delay_up_to_second_order(at: float, share: float) -> None:
    """Measured efforts are those of five milliseconds before."""
    samples = exact()
    moved = Records.make([samples], planted.CUTOFF).with_shifted_efforts(-0.005).dense[0]
    known = np.isfinite(moved.effort).all(axis=1)
    late = replace(moved, effort=np.where(known[:, None], moved.effort, samples.effort))
    inner = slice(3, -3)
    left = residual(late, {DELAY: at}, {DELAY: 0.005})[inner]
    prompt = residual(late, {}, {})[inner]
    assert np.linalg.norm(left) < share * np.linalg.norm(prompt)


def test_a_gain_scales_a_tilt_and_a_delay_that_are_built_in() -> None:
    """As it scales all that is true at its joint."""
    gravity = pin.exp3(np.array([0.03, 0.0, 0.0])).T @ MODEL.robot.gravity
    tilted = planted.recording(planted.rigid(INERTIAS, gravity), 3, SECONDS, noise=0.0)
    measured = Records.make([with_efforts(tilted, [1.0, 1.25, 1.0], [0.0] * 3, [0.0] * 3)], planted.CUTOFF)
    late = replace(measured, dense=measured.with_shifted_efforts(-0.005).dense)
    values: dict[EffectTerm, float] = {TILT[0]: 0.03, TILT[1]: 0.0, DELAY: 0.005, GAIN: 0.25}
    inner = slice(3, -3)
    left = residual(late.dense[0], values, values)[inner]
    plain = residual(late.dense[0], {}, {})[inner]
    assert np.all(np.linalg.norm(left, axis=0) < 1e-2 * np.linalg.norm(plain, axis=0))


def test_the_total_model_has_every_payload_on_its_link_and_coefficients_in_order() -> None:
    problem = LinearisedProblem.at(MODEL, Records.make([exact()], planted.CUTOFF), said({}))
    prior = Prior(
        inertias=INERTIAS.ravel(), prior_std=0.2, terms=TILT, values=np.array([0.01, 0.02]),
        prior_stds=np.ones(2), certainty=4.0,
    )  # fmt: skip
    white = (Autoregression.white(),) * 3
    found = fit(problem.design(problem.columns(prior.terms), white), prior, [PAYLOAD])
    bodies = pseudo_inertia.to_parameters(found.point.pseudo_inertias)
    total = total_model(MODEL, found)
    links = [*bodies[:2], bodies[2] + bodies[3]]
    np.testing.assert_allclose(total.inertias[list(MODEL.identified)], links)
    ((effect, place, coefficients),) = total.effects
    assert (effect, place) == (TILT[0].effect, OnRobot())
    np.testing.assert_allclose(coefficients, [found.value(term) for term in TILT])
    np.testing.assert_array_equal(total.straight_gravity, MODEL.robot.gravity)


@pytest.mark.parametrize(("tilt", "absurd"), [((0.3, -0.4), False), ((0.0, 0.6), True), ((-6e49, 0.0), True)])
def test_a_base_that_is_far_from_level_is_no_tilt(tilt: tuple[float, float], absurd: bool) -> None:
    """It is mounted otherwise; and what a motion does not tell may be anything."""
    assert GravityTilt().is_out_of_range(np.array(tilt)) is absurd


def test_absurd_coefficients_are_not_linearised_at() -> None:
    """A gain of minus one leaves nothing to scale."""
    ((_, _, coefficients),) = total_model(MODEL, said({GAIN: -1.0})).effects
    assert -1.0 < coefficients[0] < -0.5


def perturbed(found: JointFit, place: int, step: float) -> JointFit:
    """With one parameter changed."""
    parameters = found.point.parameters.copy()
    parameters[place] += step
    point: Point = found.manifold.point(parameters)
    return replace(found, point=point)


def test_the_variance_of_a_prediction_is_that_of_its_parameters() -> None:
    """By differences of what the model leaves when one parameter after the other is another; of a payload, too."""
    records = Records.make([planted.recording(RIGID, 3, SECONDS)], planted.CUTOFF)
    problem = LinearisedProblem.at(MODEL, records, said({VISCOUS: 0.1}))
    prior = Prior(
        inertias=INERTIAS.ravel(), prior_std=0.2, terms=(VISCOUS,), values=np.array([0.1]), prior_stds=np.array([0.1]),
        certainty=4.0,
    )  # fmt: skip
    columns = problem.columns(prior.terms)
    found = fit(problem.design(columns, (Autoregression.white(),) * 3), prior, [PAYLOAD])
    here, step = problem.residual(found, columns), 1e-6
    places = range(found.manifold.dimension)
    slopes = [(here - problem.residual(perturbed(found, place, step), columns)) / step for place in places]
    expected = np.einsum("dnc,de,enc->nc", slopes, found.covariance, slopes)
    np.testing.assert_allclose(problem.variance(found), expected, rtol=1e-4)


class Rough(ViscousFriction):
    """Dry friction, whatever the load."""

    name = "rough"

    @classmethod
    def dry_friction(cls, coefficient: float, load: np.ndarray) -> np.ndarray:
        return np.full(load.shape, abs(coefficient))


def test_friction_of_several_effects_at_a_joint_adds_up() -> None:
    records = Records.make([exact()], planted.CUTOFF)
    rough: list[tuple[Effect, AtJoint, np.ndarray]] = [
        (Rough(), AtJoint(joint), np.array([size])) for joint, size in ((0, 0.2), (0, -0.3), (2, 0.1))
    ]
    total = replace(total_model(MODEL, said({VISCOUS: 0.4})), effects=tuple(rough))
    problem = LinearisedProblem(MODEL, records, total)
    np.testing.assert_allclose(problem._dry_friction, np.tile([0.5, 0.0, 0.1], (len(records.samples), 1)))


def test_friction_by_load_is_of_all_that_the_gear_transmits() -> None:
    """Viscous friction, too."""
    records = Records.make([exact()], planted.CUTOFF)
    total = total_model(MODEL, said({VISCOUS: 0.5, EffectTerm(LoadFriction(), AtJoint(1)): 0.2}))
    problem = LinearisedProblem(MODEL, records, total)
    (chosen,) = records.chosen
    _, q, v, a = planted.motion(3, SECONDS)
    expected = 0.2 * np.abs(RIGID(q, v, a) + [0.0, 0.5, 0.0] * v)[chosen, 1]
    np.testing.assert_allclose(problem._dry_friction[:, 1], expected, atol=1e-9)


def test_without_a_floor_no_friction_makes_an_instant_unsure() -> None:
    records = Records.make([exact()], planted.CUTOFF)
    total = replace(total_model(MODEL, said({})), effects=((Rough(), AtJoint(0), np.array([9.0])),))
    free, bounded = LinearisedProblem(MODEL, records, total), LinearisedProblem(MODEL, records, total, np.full(3, 0.01))
    np.testing.assert_array_equal(free.valid, records.usable(MODEL, free.rows.targets))
    assert np.count_nonzero(bounded.valid[:, 0]) < np.count_nonzero(free.valid[:, 0])
    np.testing.assert_array_equal(free.with_floor(bounded.floor).valid, bounded.valid)
