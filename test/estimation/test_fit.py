"""The noise of each group of rows, and the spread of each link, as the data say them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation import estimator
from geomid_ros.estimation.fit import CERTAINTY, Fit, fit, with_fitted_effects, with_second_start
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REGIMES, regimes
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.session.configuration import Configuration
from geomid_ros.types import FloatArray

from .arms import Case, Truth, arm, efforts, identifier, solved

NOISE = 0.05


def problem(case: Case, gamma: float | None = None) -> Problem:
    unknown = np.full(len(case.model.channels), np.nan)
    return Problem(case.model, identifier(case).snapshot(), None, weighed_rows(case.model, ()), unknown, gamma, 1.0)


def fitted(case: Case, gamma: float | None = None) -> Fit:
    return fit(problem(case, gamma), tolerance=1e-8, max_steps=200)


def with_links(case: Case, links: FloatArray, seed: int) -> Case:
    """The same motion of a robot with these true links."""
    true = Truth(links, case.true.effects)
    clean = efforts(case.model.robot, true, case.samples)
    noise = NOISE * np.random.default_rng(seed).normal(size=clean.shape)
    return replace(case, true=true, noiseless=clean, samples=replace(case.samples, effort=clean + noise))


def distances(found: Fit, links: FloatArray) -> FloatArray:
    """Of each link from another table ``(links, 10)``."""
    own = found.point.pseudo_inertias
    return np.array([spd.distance(a, pseudo_inertia.from_parameters(b)) for a, b in zip(own, links, strict=True)])


def test_a_link_that_is_wrong_alone_is_let_go_and_the_others_stay() -> None:
    """Its mass is thrice the URDF's. Its spread grows, that of the others does not; one spread for all links, found
    from the same data, would loosen them, too."""
    wrong, seed = 4, 1
    case = arm("arm7", seed)
    nominal = case.model.nominal_inertias.reshape(-1, 10)
    links = nominal.copy()
    links[wrong] *= 3.0
    found = fitted(with_links(case, links, seed))
    others = np.delete(np.arange(len(links)), wrong)
    assert found.prior_stds[wrong] > 1.5 * DEFAULT_PRIOR_STD
    assert np.all(found.prior_stds[others] < 1.1 * DEFAULT_PRIOR_STD)
    assert found.point.pseudo_inertias[wrong, 3, 3] == pytest.approx(links[wrong, 0], rel=0.15)
    from_urdf = distances(found, nominal)
    assert np.all(from_urdf[others] < 0.25 * from_urdf[wrong])
    wide = spd.distance(*(pseudo_inertia.from_parameters(table[wrong]) for table in (nominal, links)))
    assert distances(found, links)[wrong] < 0.6 * wide, "what of it the motion tells is found"


def test_rows_at_rest_get_their_own_noise() -> None:
    """Where friction may have any value, at rest, rows are trusted less; those in motion no less for it."""
    case = halting("arm3", 0)
    rest = case.samples.velocity == 0.0
    noise = np.random.default_rng(0).normal(size=rest.shape) * np.where(rest, 1.0, NOISE)
    case = case.with_efforts(case.noiseless + noise)
    found = fitted(case)
    counts, sigmas = (each.reshape(REGIMES, -1) for each in (found.problem.counts, found.sigmas))
    np.testing.assert_array_equal(counts[-1], np.count_nonzero(rest, axis=0))
    np.testing.assert_array_equal(np.sum(counts[:-1], axis=0), np.count_nonzero(~rest, axis=0))
    np.testing.assert_allclose(sigmas[0], NOISE, rtol=0.2)
    np.testing.assert_allclose(sigmas[-1], 1.0, rtol=0.2)
    assert np.all(case.error(found.point.parameters) < NOISE)


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_slow_rows_get_their_own_noise_however_few(share: float) -> None:
    """Friction near rest is not what it is in motion, which spoils nothing else; few rows say so as well as many."""
    case = arm("arm3", 0, seconds=40)
    rng = np.random.default_rng(0)
    kept = (regimes(case.samples) == 0).all(axis=1) | (rng.random(len(case.samples)) < share)
    case = replace(case, samples=case.samples.select(kept), noiseless=case.noiseless[kept])
    slow = regimes(case.samples) > 0
    noise = rng.normal(size=slow.shape) * np.where(slow, 20.0 * NOISE, NOISE)
    found = fitted(case.with_efforts(case.noiseless + noise))
    fast, slower, _ = found.sigmas.reshape(REGIMES, -1)
    assert share == 1.0 or np.any(found.problem.counts[3:6] < len(found.problem.model.channels[0].columns))
    np.testing.assert_allclose(fast, NOISE, rtol=0.1)
    np.testing.assert_allclose(slower, 20.0 * NOISE, rtol=0.5)
    assert np.all(case.error(found.point.parameters) < NOISE)


def test_rows_at_rest_are_no_surer_than_those_in_motion() -> None:
    """The same pose again and again is no proof of an exact sensor."""
    case = halting("arm3", 0)
    rest = case.samples.velocity == 0.0
    noise = NOISE * np.random.default_rng(0).normal(size=rest.shape) * ~rest
    fast, slow, still = np.split(fitted(case.with_efforts(case.noiseless + noise)).sigmas, REGIMES)
    np.testing.assert_allclose(fast, NOISE, rtol=0.1)
    np.testing.assert_allclose(still, np.maximum(fast, slow), rtol=1e-9)


def test_a_joint_that_never_moves_tells_of_the_others_by_its_noise_at_rest() -> None:
    """It has no rows in motion that could say how sure it is."""
    case = arm("arm3", 0)
    held = np.array([False, False, True])
    moving = {key: np.where(held, 0.0, getattr(case.samples, key)) for key in ("velocity", "acceleration")}
    position = np.where(held, 0.7, case.samples.position)
    at_rest = replace(case.samples, position=position, **moving)
    clean = efforts(case.model.robot, case.true, at_rest)
    noise = NOISE * np.random.default_rng(0).normal(size=clean.shape)
    found = fitted(replace(case, samples=replace(at_rest, effort=clean + noise)))
    assert found.sigmas[-1] == pytest.approx(NOISE, rel=0.1)


def test_noise_and_spreads_are_a_fixed_point() -> None:
    """From another start the fit ends at the same minimum."""
    case = arm("arm7", 3)
    whole = problem(case)
    cold = fit(whole, tolerance=1e-10, max_steps=300)
    far = whole.manifold.point(case.truth)
    warm = fit(whole, far, tolerance=1e-10, max_steps=300)
    np.testing.assert_allclose(warm.sigmas, cold.sigmas, rtol=1e-6)
    np.testing.assert_allclose(warm.prior_stds, cold.prior_stds, rtol=1e-5)
    np.testing.assert_allclose(warm.point.parameters, cold.point.parameters, rtol=1e-4, atol=1e-6)


def test_a_links_spread_is_its_distance_from_the_prior_and_what_is_unsure_of_it() -> None:
    """MacKay's fixed point, with the posterior's covariance by its principal directions."""
    found = fit(problem(arm("arm3", 1)), tolerance=1e-10, max_steps=300)
    manifold, prior = found.problem.manifold, found.problem.prior_point
    information = found.objective.evaluate(found.point).information + np.diag(found.objective.prior_weights)
    values, vectors = np.linalg.eigh(information)
    links = manifold.inertial
    squares = manifold.log(prior, found.point)[links] ** 2 + np.sum(vectors**2 / values, axis=1)[links]
    of_links = np.sum(squares.reshape(-1, 10), axis=1)
    expected = np.sqrt((of_links + CERTAINTY * DEFAULT_PRIOR_STD**2) / (10.0 + CERTAINTY))
    np.testing.assert_allclose(found.prior_stds, expected, rtol=1e-5)


@cache
def unlike() -> Case:
    """An arm whose third link is unlike the URDF's in all but its mass."""
    case = arm("arm3", 1)
    links = case.true.links.copy()
    links[2, 1:4] += 0.2 * links[2, 0]
    links[2, 4:] *= 5.0
    clean = efforts(case.model.robot, Truth(links, case.true.effects), case.samples)
    measured = replace(case.samples, effort=clean + case.samples.effort - case.noiseless)
    return replace(case, samples=measured.select(np.arange(len(clean)) % 4 == 0))


def released(*masses_held: int) -> Fit:
    """The fit to it."""
    return fit(replace(problem(unlike()), masses_held=dict.fromkeys(masses_held, 1.0)), tolerance=1e-12, max_steps=300)


@pytest.mark.parametrize("masses_held", [(), (1,)])
def test_the_score_is_the_density_of_what_was_measured(masses_held: tuple[int, ...]) -> None:
    """Of all rows at once, with their dense covariance: that of the noise, and of what the prior leaves unsure. The
    links' spreads have their own. What is known of a mass is one more row, but nobody measured it."""
    case, found = unlike(), released(*masses_held)
    manifold, prior, known = found.problem.manifold, found.problem.prior_point, found.problem.known
    rows, channel = case.model.rows(case.samples), np.arange(len(case.model.channels))
    sigmas = found.sigmas.reshape(REGIMES, -1)[regimes(case.samples), channel].ravel()
    coefficients = np.concatenate([rows.coefficients.reshape(len(sigmas), -1), known.rows])
    left = np.append(rows.targets.ravel(), known.targets) - coefficients @ found.point.parameters
    tangent = manifold.whiten(found.point, coefficients)
    variances = np.append(sigmas**2, np.ones(len(known.rows)))
    covariance = np.diag(variances) + (tangent * found.assumed_prior_stds**2) @ tangent.T
    off = left - tangent @ manifold.log(found.point, prior)
    density = np.linalg.slogdet(covariance)[1] + off @ np.linalg.solve(covariance, off)
    wide = found.prior_stds / DEFAULT_PRIOR_STD
    assert np.all(wide[1:] > 2.0)
    density -= 2.0 * float(np.sum(np.log(wide[list(masses_held)])))
    expected = density + CERTAINTY * np.sum(wide**-2.0 + 2.0 * np.log(wide))
    assert found.score == pytest.approx(expected, abs=0.05)


def test_a_mass_that_is_held_has_the_usual_prior_in_a_link_that_left_its_own() -> None:
    """The information of the prior alone, inverted: at the prior a mass is known to a fifth, and a first moment as
    badly as the link is."""
    free, held = released(), released(1)
    prior, stds = held.problem.prior_point, held.prior_stds
    manifold, first = held.problem.manifold, held.problem.manifold.inertial.stop
    known = replace(held.problem, known=weighed_rows(held.problem.model, ())).with_masses_at(prior, stds).known
    tangent = manifold.whiten(prior, known.rows)[:, :first]
    covariance = np.linalg.inv(np.diag(np.repeat(stds**-2.0, 10)) + tangent.T @ tangent)
    jacobian = prior.links_jacobian[1]
    mass, moment, *_ = np.sqrt(np.diag(jacobian @ covariance[10:20, 10:20] @ jacobian.T))
    usual = np.linalg.norm(jacobian, axis=1) * DEFAULT_PRIOR_STD
    assert mass == pytest.approx(usual[0])
    assert mass == pytest.approx(DEFAULT_PRIOR_STD * prior.parameters[10])
    assert moment > 2.0 * usual[1]
    off = [abs(np.log(found.point.parameters[10] / prior.parameters[10])) for found in (held, free)]
    assert off[0] < 0.5 * off[1]


def test_of_two_minima_the_more_likely_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A link is six times as heavy, motors cog, and 2.5 s of motion tell little: beside the effects that were chosen
    there are two minima, one is reached from the prior, the other from where the choice ended. What is unsure goes, and
    leaves no trace in where the next fits begin. At last, masses that nothing contradicts are nearer to the truth."""
    case = arm("arm7", 6)
    links = case.true.links.copy()
    links[2] *= 6.0
    first = case.samples.select(np.arange(len(case.samples)) < len(case.samples) // 8)
    clean = efforts(case.model.robot, Truth(links, case.true.effects), first) + np.sin(7.0 * first.position)
    model = MeasurementModel(case.model.robot, case.effects, candidates=Configuration().candidates)
    fits: list[tuple[Fit, tuple[Any, ...]]] = []

    def recorded(problem: Problem, *start: Any, **more: Any) -> Fit:
        fits.append((fit(problem, *start, **more), start))
        return fits[-1][0]

    taken: list[Fit] = []

    def better_of(*arguments: Any) -> Callable[..., Fit]:
        best = with_second_start(*arguments)

        def solve(*given: Any, **more: Any) -> Fit:
            taken.append(best(*given, **more))
            return taken[-1]

        return solve

    monkeypatch.setattr(estimator, "fit", recorded)
    monkeypatch.setattr(estimator, "with_second_start", better_of)
    noise = 0.1 * np.random.default_rng(8).normal(size=clean.shape)
    solved(replace(case, model=model, samples=replace(first, effort=clean + noise)))
    pairs = [*zip(fits[::2], fits[1::2], strict=True)]
    for best, ((cold, of_prior), (warm, _)) in zip(taken, pairs, strict=True):
        assert of_prior == ()
        assert best is min(cold, warm, key=lambda found: found.score)
    free = [(cold, warm, given) for (cold, _), (warm, given) in pairs if not cold.problem.masses_held]
    assert 1 < len(free) < len(pairs), "something was unsure; and cogging has moved links"
    for cold, warm, (_, spreads) in free:
        np.testing.assert_array_equal(spreads, free[0][2][1])
        assert abs(cold.score - warm.score) > 5.0
    *_, last = taken
    held = [*last.problem.masses_held]
    assert len(pairs) > len(free) + 1, "without some masses, others are driven away"
    assert all(std > 2.0 * DEFAULT_PRIOR_STD for std in last.problem.masses_held.values())
    before = taken[len(free) - 1]
    off = [np.log(found.point.parameters[10 * np.array(held)] / links[held, 0]) for found in (last, before)]
    assert np.linalg.norm(off[0]) < 0.8 * np.linalg.norm(off[1])


def halting(name: str, seed: int) -> Case:
    """An arm whose joints stand still now and then, each at its own times, while the others move."""
    case = arm(name, seed)
    rest = np.zeros(case.samples.velocity.shape, dtype=bool)
    for joint in range(rest.shape[1]):
        rest[:, joint] = np.arange(len(rest)) // 100 % 5 == joint
    fast = np.where(np.abs(case.samples.velocity) < 0.05, 0.05, case.samples.velocity)
    acceleration = np.where(rest, 0.0, case.samples.acceleration)
    moving = replace(case.samples, velocity=np.where(rest, 0.0, fast), acceleration=acceleration)
    clean = efforts(case.model.robot, case.true, moving)
    return replace(case, noiseless=clean, samples=replace(moving, effort=clean))


def test_a_budget_that_is_spent_is_told() -> None:
    """A few steps settle nothing; where they are enough nothing is said."""
    case = arm("arm3", 1)
    assert not fit(problem(case), tolerance=1e-10, max_steps=300).budget_exhausted
    assert fit(problem(case), tolerance=1e-10, max_steps=1).budget_exhausted
    for most, told in ((300, False), (1, True)):
        assert any("ran out of steps" in warning for warning in solved(case, max_steps=most).warnings) == told


def test_what_was_fitted_first_is_known_to_its_own_size_at_best() -> None:
    """Of an offset that is part of a spring, as large as all that its joint feels."""
    case = arm("arm3", 0, seconds=8)
    model = MeasurementModel(case.model.robot, [identifiable()["effort_offset"], identifiable()["spring"]])
    far = case.samples.effort + 500.0 * (case.samples.position - 2.0)
    found = problem(replace(case.with_efforts(far), model=model))
    errors = found.default_coefficient_stds(found.prior_point)
    own = np.abs(found.prior_point.reals) / found.manifold.scales
    assert np.all(errors[found.model.positives :] >= own)
    assert np.max(own) > 2.0 * DEFAULT_PRIOR_STD


@pytest.mark.parametrize("fast", [0, 5])
def test_rows_of_slow_motion_stand_for_those_of_fast_motion_where_these_are_few(fast: int) -> None:
    """A few instants of a start-up do not say how sure a robot's efforts are that creeps then."""
    case = arm("arm3", 0, seconds=20)
    slow = np.arange(len(case.samples))[:, None] >= fast
    speeds = np.sign(case.samples.velocity) * np.where(slow, 0.025, 1.0)
    moving = replace(case.samples, velocity=speeds)
    clean = efforts(case.model.robot, case.true, moving)
    noise = NOISE * np.random.default_rng(0).normal(size=clean.shape)
    creeping = replace(case, samples=replace(moving, effort=clean + noise))
    np.testing.assert_allclose(solved(creeping, cutoff=10.0).sigmas, NOISE, rtol=0.15)


@pytest.mark.parametrize(("rows", "slow"), [(12, 1), (36, 12)])
def test_few_rows_of_all_kinds_are_no_proof_of_an_exact_sensor(rows: int, slow: int) -> None:
    case = arm("arm3", 0, seconds=20)
    chosen = np.random.default_rng(rows).choice(len(case.samples), rows, replace=False)
    samples = case.samples.select(np.sort(chosen))
    speeds = samples.velocity.copy()
    speeds[:slow] = np.sign(speeds[:slow]) * 0.025
    assert np.all(solved(replace(case, samples=replace(samples, velocity=speeds))).sigmas > 0.1 * NOISE)


def test_effects_are_at_the_minimum_beside_links_that_are_held() -> None:
    """A positive one that the data pull below zero is stopped by its prior alone, which is steep there."""
    slope = 100.0
    manifold, body = ParameterManifold(1, 1, np.ones(1)), np.array([1.0, *[0.0] * 3, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1])
    prior = manifold.point(np.array([*body, 1.0, 0.0]))
    rows = np.column_stack([np.ones((2, 1)), np.zeros((2, 9)), np.diag([slope, 1.0]), [1.0 - slope, 2.0]])
    objective = ResidualObjective(manifold, rows.T @ rows, prior, np.ones(12), 1.0)
    found = with_fitted_effects(objective, prior)
    np.testing.assert_array_equal(found.pseudo_inertias, prior.pseudo_inertias)
    assert found.reals == pytest.approx(0.5, rel=1e-9), "what the link's mass leaves, half way from the prior"
    assert np.all(np.abs(objective.evaluate(found).gradient[10:]) < 1e-6)
