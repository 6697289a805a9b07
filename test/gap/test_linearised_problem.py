"""The problem linearised at a total model: planted robots whose effects are known leave nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.gap.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import FEWEST_ROWS, Records
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.candidates import EffectTerm
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior
from geomid_ros.inference.prior import Prior
from geomid_ros.model.effects import AtJoint, Effect, OnRobot, identified_effect
from geomid_ros.model.effects.friction import CoulombFriction, LoadFriction, ViscousFriction
from geomid_ros.model.effects.mounting import GravityTilt
from geomid_ros.model.effects.sensor_errors import EffortDelay, EffortGain, EffortOffset
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray

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
WHITE = (Autoregression.white(),) * 3
TILT = tuple(EffectTerm(GravityTilt(), OnRobot(), index) for index in range(2))


def exact(seed: int = 3) -> Samples:
    """Without noise."""
    return planted.recording(RIGID, seed, SECONDS, noise=0.0)


def said(values: dict[EffectTerm, float]) -> JointFit:
    """The planted robot with these coefficients, as if it were a fit."""
    return fit_of_prior(prior_of(values))


def prior_of(values: dict[EffectTerm, float], std: float = 1.0) -> Prior:
    """The planted robot with these coefficients, each known to a standard deviation."""
    known = np.array(list(values.values()))
    stds = np.full(len(known), std)
    return replace(planted.prior(INERTIAS), terms=tuple(values), values=known, prior_stds=stds)


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


@pytest.mark.parametrize("at", [0.0, -0.3])
def test_a_gain_is_the_whole_gain_wherever_it_is_linearised(at: float) -> None:
    """It scales all that is at its joint; of what a model with another gain predicts it is a column there."""
    samples = with_efforts(exact(), [1.0, 1.25, 1.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.0])
    values: dict[EffectTerm, float] = {VISCOUS: 0.4, GAIN: 0.25}
    np.testing.assert_allclose(residual(samples, {VISCOUS: 0.4, GAIN: at}, values), 0.0, atol=1e-9)


@pytest.mark.parametrize(("at", "share"), [(0.03, 1e-4), (0.0, 0.1)])
def test_a_tilt_is_the_whole_tilt_up_to_second_order(at: float, share: float) -> None:
    gravity = pin.exp3(np.array([0.03, 0.0, 0.0])).T @ MODEL.robot.gravity
    tilted = planted.recording(planted.rigid(INERTIAS, gravity), 3, SECONDS, noise=0.0)
    values: dict[EffectTerm, float] = {TILT[0]: 0.03, TILT[1]: 0.0}
    left = residual(tilted, {TILT[0]: at, TILT[1]: 0.0}, values)
    straight = residual(tilted, {}, {})
    assert np.linalg.norm(left) < share * np.linalg.norm(straight)


@pytest.mark.parametrize(("at", "share"), [(0.005, 1e-2), (0.0, 0.1)])
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
    prior = prior_of(dict(zip(TILT, (0.01, 0.02), strict=True)))
    found = fit(problem.design(problem.columns(prior.terms), WHITE), prior, [PAYLOAD])
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


def test_the_variance_of_a_prediction_is_that_of_its_parameters() -> None:
    """By differences of what the model leaves when one parameter after the other is another; of a payload, too."""
    records = Records.make([planted.recording(RIGID, 3, SECONDS)], planted.CUTOFF)
    problem = LinearisedProblem.at(MODEL, records, said({VISCOUS: 0.1}))
    columns = problem.columns([VISCOUS])
    found = fit(problem.design(columns, WHITE), prior_of({VISCOUS: 0.1}, std=0.1), [PAYLOAD])
    here, step, slopes = problem.residual(found, columns), 1e-6, []
    for change in step * np.eye(found.manifold.dimension):
        other = replace(found, point=found.manifold.point(found.point.parameters + change))
        slopes.append((here - problem.residual(other, columns)) / step)
    expected = np.einsum("dnc,de,enc->nc", slopes, found.covariance, slopes)
    np.testing.assert_allclose(problem.variance(found), expected, rtol=1e-4)


def test_dry_friction_of_several_effects_adds_up_and_that_by_load_is_of_the_links() -> None:
    """Not of viscous friction; instants are unsure by the floor, and none is without one."""
    records = Records.make([exact()], planted.CUTOFF)
    dry: list[tuple[Effect, AtJoint, np.ndarray]] = [
        (CoulombFriction(smoothing), AtJoint(0), np.array([size])) for smoothing, size in ((0.02, 9.0), (0.003, -0.3))
    ]
    total = total_model(MODEL, said({VISCOUS: 0.5, EffectTerm(LoadFriction(), AtJoint(1)): 0.2}))
    total = replace(total, effects=(*total.effects, *dry))
    problem = LinearisedProblem(MODEL, records, total)
    _, q, v, a = planted.motion(3, SECONDS)
    loads = 0.2 * np.abs(RIGID(q, v, a))[records.chosen[0], 1]
    np.testing.assert_allclose(problem._dry_friction[:, 0], 9.3)
    np.testing.assert_allclose(problem._dry_friction[:, 1], loads, atol=1e-9)
    assert not np.any(problem._dry_friction[:, 2])
    np.testing.assert_array_equal(problem.valid, records.usable(MODEL, problem.rows.targets))
    bounded = problem.with_floor(np.full(3, 0.01))
    assert np.count_nonzero(bounded.valid[:, 0]) < np.count_nonzero(problem.valid[:, 0])


FLOOR = np.full(3, planted.NOISE)
MILD = planted.true_inertias(2, 0.1)
RECORDS = Records.make([planted.recording(planted.rigid(MILD), 2)], planted.CUTOFF)


def problem_with(joint: int, level: float, floor: float = 1.0) -> LinearisedProblem:
    """With Coulomb friction of a level at a joint, where the noise is so many times the planted one."""
    friction = (identified_effect("coulomb_friction"), AtJoint(joint), np.array([level]))
    total = replace(total_model(MODEL, fit_of_prior(planted.prior(MILD))), effects=(friction,))
    return LinearisedProblem(MODEL, RECORDS, total, floor * FLOOR)


def valid_with(joint: int, level: float, floor: float = 1.0) -> BoolArray:
    """The valid_with instants of that problem_with."""
    return problem_with(joint, level, floor).valid


def test_noise_by_which_hardly_an_instant_counts_is_not_told() -> None:
    """It is what few rows leave: by it fewer count, which leave less, until nothing is judged there."""
    before = problem_with(2, 2.0)
    left = FLOOR * [0.9, 0.9, 0.0]
    assert np.count_nonzero(before.with_floor(left).valid[:, 2]) < FEWEST_ROWS < np.count_nonzero(before.valid[:, 2])
    floor, told = before.identifiable_floor(left)
    np.testing.assert_array_equal(told, [True, True, False])
    np.testing.assert_array_equal(floor, np.where(told, left, before.floor))
    for other in (before, before.with_floor(np.full(3, np.inf))):
        floor, told = other.identifiable_floor(0.9 * FLOOR)
        np.testing.assert_array_equal(floor, 0.9 * FLOOR)
        assert np.all(told)


@pytest.mark.parametrize("joint", [0, 2])
def test_the_more_friction_for_the_noise_the_fewer_instants_count(joint: int) -> None:
    sets = [valid_with(joint, level)[:, joint] for level in (0.0, 0.1, 1.0, 10.0)]
    for smaller, larger in zip(sets[1:], sets, strict=False):
        assert np.all(larger[smaller])
        assert np.count_nonzero(smaller) < np.count_nonzero(larger)
    np.testing.assert_array_equal(sets[0], RECORDS.usable(MODEL, MODEL.rows(RECORDS.samples).targets)[:, joint])
    np.testing.assert_array_equal(valid_with(joint, 10.0, floor=10.0)[:, joint], sets[2])


def test_a_reversal_reaches_the_joint_that_its_acceleration_loads() -> None:
    """Joints 2 and 3 of the arm turn about parallel axes."""
    lost = np.count_nonzero(valid_with(2, 0.0) & ~valid_with(2, 0.5), axis=0)
    assert lost[1] > 0.3 * lost[2] > 0
