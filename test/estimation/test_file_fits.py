"""What is fitted within what a file can hold: the minimum there, and no placeholder of the input."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.estimation import effect_selection
from geomid_ros.estimation.effect_selection import file_fit, held_columns
from geomid_ros.estimation.estimator import _masses
from geomid_ros.estimation.fit import fit
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.estimation.solvers import trust_region
from geomid_ros.files.models.readers import ELEMENTS
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from .arms import Case, Truth, arm, efforts, identifier, solved
from .test_fit import problem

URDF, ALL = {"urdf": ELEMENTS["urdf"]}, {"all": ("urdf", "mjcf", "drake", "gazebo")}


def error(case: Case, parameters: FloatArray) -> float:
    """Sum of the channels' RMS, errors of sensors apart."""
    measured, predicted = case.model.predict(case.samples, parameters)
    return float(np.sum(np.std(measured - predicted, axis=0)))


def test_a_file_that_holds_everything_is_the_estimate() -> None:
    found = solved(arm("arm3", 1, noise=0.05), files=ALL)
    np.testing.assert_allclose(found.within["all"], found.parameters, rtol=1e-6, atol=1e-9)


def test_no_file_is_fitted_to_an_estimate_by_which_rows_are_made_anew() -> None:
    """All else is the same."""
    identified = identifier(arm("arm3", 1, noise=0.05), files=ALL)
    found, passing = (identified.solve_unless(lambda _, answer=answer: answer) for answer in (False, True))
    assert found.within.keys() == ALL.keys()
    assert not passing.within
    np.testing.assert_array_equal(passing.parameters, found.parameters)


@pytest.mark.parametrize("seed", [0, 1])
def test_what_a_file_lacks_is_made_up_for_by_the_rest(seed: int) -> None:
    """Not dropped from a sum that needs it. Inertias stand in for rotors, no mass does: masses are known from gravity,
    as well as the estimate says."""
    case = arm("arm3", seed, noise=0.05)
    found = solved(case, files=URDF)
    held = held_columns(case.model, np.arange(case.model.dimension), ELEMENTS["urdf"])
    lacking = np.setdiff1d(np.arange(case.model.dimension), held)
    assert {case.model.coefficients[k - 30].effect.name for k in lacking} == {"rotor_inertia"}
    np.testing.assert_array_equal(found.within["urdf"][lacking], 0.0)
    dropped = found.parameters.copy()
    dropped[lacking] = 0.0
    assert error(case, found.within["urdf"]) < error(case, dropped)
    for place, link in enumerate(found.links):
        assert abs(found.within["urdf"][10 * place] - link.mass) < 3.0 * link.std_mass, link.name


def test_sums_of_masses_are_known_to_a_file_as_well_as_to_the_estimate() -> None:
    """Though each mass is not: they are neighbours' on the axis of a joint."""
    found = solved(arm("arm3", 0, noise=0.05))
    rows = _masses(found)
    masses = slice(0, 10 * len(found.links), 10)
    covariance = np.linalg.inv(rows.rows[:, masses].T @ rows.rows[:, masses])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [link.std_mass for link in found.links], rtol=0.01)
    expected = found.posterior.parameter_covariance[masses, masses]
    correlation = expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.min(correlation) < -0.3
    np.testing.assert_allclose(covariance, expected, atol=0.02 * np.max(expected))
    np.testing.assert_allclose(rows.rows @ found.parameters, rows.targets)
    far = replace(found, links=(*found.links[:-1], replace(found.links[-1], std=4.0 * found.links[-1].std)))
    rows = _masses(far)
    wider = np.linalg.inv(rows.rows[:, masses].T @ rows.rows[:, masses])
    assert wider[-1, -1] == pytest.approx(16.0 * covariance[-1, -1], rel=0.01), "the metric is curved there"
    np.testing.assert_allclose(wider[:-1], covariance[:-1], rtol=1e-6, atol=1e-9)


def test_links_change_only_for_a_better_prediction() -> None:
    """What noise hides is no reason: with it the links of this robot are the estimate's."""
    found = solved(arm("arm3", 2, seconds=4.0, noise=10.0), files=URDF)
    np.testing.assert_allclose(found.within["urdf"][:30], found.parameters[:30], rtol=1e-6)


def test_the_fit_that_predicts_unseen_time_wins() -> None:
    """Against one of too strong a prior, and against one that follows the noise, whichever is the file's."""
    case = arm("arm3", 0, seconds=4.0, noise=0.5)
    best, stiff, loose = (fit(problem(case, gamma), tolerance=1e-8, max_steps=200) for gamma in (None, 1e-2, 1e-9))
    np.testing.assert_array_equal(file_fit(best, stiff), best.point.parameters)
    for worse in (stiff, loose):
        chosen = file_fit(worse, best)
        np.testing.assert_allclose(chosen[:30], best.point.parameters[:30], rtol=1e-9)
        there = worse.objective.evaluate(worse.problem.manifold.point(chosen))
        assert np.all(np.abs(there.gradient[30:]) < 0.01 * np.sqrt(np.diag(there.information)[30:])), "effects fitted"


def test_a_fold_is_left_out_in_one_step() -> None:
    """To the minimum of the other folds; so far that the rest follows if the links' part of the step is given."""
    found = fit(problem(arm("arm3", 1)), tolerance=1e-10, max_steps=300)
    manifold, links, products = found.problem.manifold, found.problem.manifold.inertial, found.fold_products
    steps = effect_selection._steps(found, products)
    np.testing.assert_allclose(effect_selection._steps(found, products, steps[:, links]), steps, rtol=1e-6, atol=1e-9)
    ends = effect_selection._without_folds(found, products)
    squares = np.einsum("fi,fij,fj->f", ends, products, ends)
    np.testing.assert_allclose(found.problem.summary.fold_squares(found.sigmas, ends), squares, rtol=1e-6)
    for fold, end in zip(products, ends, strict=True):
        others = np.sum(products, axis=0) - fold
        prior, weights = found.problem.prior_point, found.objective.prior_weights
        exact = trust_region(ResidualObjective(manifold, others, prior, weights, 1.0), found.search_point).point
        off, moved = end[:-1] - exact.parameters, found.search_point.parameters - exact.parameters
        assert off @ others[:-1, :-1] @ off < 0.01 * moved @ others[:-1, :-1] @ moved


def test_a_placeholder_that_the_data_refute_is_gone() -> None:
    case, claimed = arm("arm3", 0, noise=0.05), with_damping(arm("arm3", 0, noise=0.05), 100.0)
    true = viscous(case, case.truth)
    estimate = solved(claimed, files=URDF)
    for found in (estimate.within["urdf"], estimate.parameters):
        np.testing.assert_allclose(viscous(case, found), true, rtol=0.3, atol=0.05)


def test_what_the_input_says_of_a_joint_that_stands_still_holds() -> None:
    case = with_damping(arm("arm3", 0, noise=0.05), 3.0)
    moving = {name: getattr(case.samples, name) for name in ("position", "velocity", "acceleration")}
    still = {name: values * [1.0, 1.0, 0.0] for name, values in moving.items()}
    standing = replace(case, samples=_with(case, still))
    assert viscous(case, solved(standing, files=URDF).within["urdf"])[2] == pytest.approx(3.0, rel=0.01)


def test_an_offset_does_not_stand_in_for_a_mass() -> None:
    """A joint that hardly turns feels the weight behind it as a constant; nothing is wrong with its sensor."""
    case = arm("arm3", 1, noise=0.05)
    small = {name: 0.05 * getattr(case.samples, name) for name in ("position", "velocity", "acceleration")}
    narrow = _with(case, small)
    rows = case.model.rows(narrow)
    truth = case.truth.copy()
    truth[_offsets(case)] = 0.0
    measured = np.einsum("ncd,d->nc", rows.coefficients, truth)
    noisy = measured + 0.02 * np.random.default_rng(1).normal(size=measured.shape)
    found = solved(Case(case.model, _with(case, small, noisy), noisy, truth, case.true), files=URDF)
    weights = np.sqrt(np.mean(measured**2, axis=0))
    assert np.all(np.abs(found.parameters[_offsets(case)]) < 0.1 * weights)
    # A file has no place for what might be an offset: all of the weight is in its links.
    alone = found.within["urdf"].copy()
    alone[_offsets(case)] = 0.0
    predicted = np.einsum("ncd,d->nc", rows.coefficients, alone)
    assert np.all(np.abs(np.mean(predicted - measured, axis=0)) < 0.01 * weights)


def test_the_offset_of_a_spring_is_no_error_of_a_sensor() -> None:
    """A file without the spring holds the weight that motor and spring carry, as far as links can; one with it has
    both."""
    case = arm("arm3", 1, noise=0.05)
    spring = 3.0 * (case.samples.position[:, 1] - 1.0)
    pulled = case.with_efforts(case.samples.effort + np.outer(spring, [0.0, 1.0, 0.0]))
    model = MeasurementModel(case.model.robot, case.effects, candidates=[identifiable()["spring"]])
    found = solved(replace(pulled, model=model), files=URDF | {"mujoco": ELEMENTS["mujoco"]})
    offsets = [30 + k for k, c in enumerate(model.coefficients) if c.effect.is_sensor_error]
    np.testing.assert_allclose(found.within["mujoco"], found.parameters, rtol=1e-3)
    alone = found.within["urdf"].copy()
    alone[offsets] = 0.0
    measured, predicted = model.predict(pulled.samples, alone)
    left = np.sqrt(np.mean((measured - predicted) ** 2, axis=0))[1]
    assert left < 0.7 * abs(found.parameters[offsets[1]])


def test_an_error_of_a_sensor_is_significant_beside_a_file() -> None:
    """Not in the estimate alone, whose rotors leave less unexplained at the last joint than a file without them."""
    case = arm("arm3", 0)
    small = Truth(case.true.links, {**case.true.effects, "effort_offset": np.full(3, 0.003)})
    clean = efforts(case.model.robot, small, case.samples)
    found = solved(case.with_efforts(clean + 1e-3 * np.random.default_rng(0).normal(size=clean.shape)), files=URDF)
    offsets = [effect for effect in found.effects if effect.name == "effort_offset"]
    assert all(offset.value > 10.0 * offset.std for offset in offsets)
    np.testing.assert_array_equal(found.within["urdf"][_offsets(case)] == 0.0, [False, False, True])


def _with(case: Case, motion: dict[str, FloatArray], effort: FloatArray | None = None) -> Samples:
    return replace(case.samples, **motion, effort=case.samples.effort if effort is None else effort)


def _offsets(case: Case) -> FloatArray:
    return np.array([30 + k for k, c in enumerate(case.model.coefficients) if c.effect.name == "effort_offset"])


def viscous(case: Case, parameters: FloatArray) -> FloatArray:
    """Of each joint."""
    return np.array([parameters[30 + k] for k, c in enumerate(case.model.coefficients) if "viscous" in c.effect.name])


def with_damping(case: Case, damping: float) -> Case:
    """The same measurements of a robot whose URDF claims this damping at every joint."""
    urdf = re.sub(r"<dynamics[^>]*/>", "", case.model.robot.urdf)
    claimed = re.sub("</joint>", f'<dynamics damping="{damping}"/></joint>', urdf)
    effects = list(dict.fromkeys(c.effect for c in case.model.coefficients))
    model = MeasurementModel(Robot(claimed), effects)
    return Case(model, case.samples, case.noiseless, case.truth, case.true)


def test_a_file_may_choose_what_a_population_tells_and_the_estimate_has_not() -> None:
    """Quadratic friction, which a URDF does not hold: viscous friction is in its place."""
    case = arm("arm3", 1, noise=0.05)
    standing = [effect for effect in case.effects if effect.name != "viscous_friction"]
    tried = [identifiable()[name] for name in ("viscous_friction", "quadratic_friction")]
    model = MeasurementModel(case.model.robot, standing, candidates=tried)
    true = {"quadratic_friction": 1.0, "coulomb_friction": 0.3, "rotor_inertia": 0.02}
    sizes = [true.get(coefficient.effect.name, 0.0) for coefficient in model.coefficients]
    truth = np.append(case.truth[: len(model.nominal_inertias)], sizes)
    targets = np.einsum("ncd,d->nc", model.rows(case.samples).coefficients, truth)
    targets += 0.05 * np.random.default_rng(0).normal(size=targets.shape)
    recorded = Case(model, replace(case.samples, effort=targets), targets, truth, case.true)
    found = solved(recorded, files=URDF, population=population(model))
    assert not np.any(viscous(recorded, found.parameters))
    assert np.any(viscous(recorded, found.within["urdf"]))


def population(model: MeasurementModel) -> Population:
    """Of ten robots that differ in all that a model has."""
    effects = tuple(
        EffectCoordinate(name=c.effect.name, place=c.place_name, parameter=c.parameter, unit="", positive=c.positive)
        for c in model.coefficients
    )
    parameters = np.append(model.nominal_inertias, np.full(len(effects), 0.1))
    signed = sum(not coefficient.positive for coefficient in model.coefficients)
    covariance = np.diag(np.full(len(parameters), 0.3**2))
    return Population(
        links=model.body_names,
        effects=effects,
        parameters=parameters,
        scales=np.ones(signed),
        covariance=covariance,
        robots=10,
    )
