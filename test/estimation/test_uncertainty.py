"""What the estimate says of its own certainty: linear algebra it must reproduce, and how often it is right."""

from __future__ import annotations

from collections import defaultdict
from functools import cache

import numpy as np
import pytest
from geometry import bodies
from model.robots import with_values
from scipy.signal import lfilter

from geomid_ros.estimation.estimate import (
    FINEST,
    QUANTITIES,
    Estimate,
    LinksInformation,
    effort_deviations,
    quantities_and_moments,
)
from geomid_ros.estimation.estimate_parts import deviations_of, sensitivity_of_numbers
from geomid_ros.estimation.estimator import WHITE_ROWS_PER_PERIOD, EstimatorSettings, estimate, filtered_fraction
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.solvers import trust_region
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.uncertainty import (
    Fold,
    Folds,
    GridSteps,
    ParameterGroup,
    Uncertainty,
    error_covariance,
    estimate_uncertainty,
    estimated_prior_stds,
    information_inverse,
    information_inverse_root,
    physical_sensitivity,
    stds_along_geodesics,
    variance_inflation,
    with_enlarged_prior,
)
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.signals.kernels import derivative_kernels
from geomid_ros.types import FloatArray

from .arms import ALL_EFFECTS, Case, arm, identifier, summary, truth
from .arms import parameters as parameters_of
from .problems import ALL, LINKS

RUNS = 20
NOISE = 0.05
CORRELATION = 0.95


# --- the linear algebra ---------------------------------------------------------------------------------------------


def information(rng: np.random.Generator, size: int, rank: int) -> FloatArray:
    rows = rng.normal(size=(rank, size)) * 10.0 ** rng.uniform(0, 2, size=(rank, 1))
    return rows.T @ rows


def one_group(size: int, usual: float = 0.2) -> list[ParameterGroup]:
    return [ParameterGroup(np.arange(size), usual)]


def nothing(size: int) -> Fold:
    return Fold(np.zeros(size), np.zeros((size, size)))


def test_the_covariance_is_that_of_the_errors_whatever_the_weights() -> None:
    """Of many regularised least-squares solutions, with noise that is larger than the weights say; and with errors of
    the prior that are three times as large as it says."""
    rng = np.random.default_rng(1)
    rows, weighed = rng.normal(size=(5, 6)), rng.normal(size=(2, 6))
    spreads, weights = rng.uniform(0.1, 2.0, 6), rng.uniform(0.1, 10.0, 6)
    inflation, trust, runs = 4.0, 30.0, 40000
    left = np.concatenate([rows, np.sqrt(trust) * weighed, np.diag(np.sqrt(weights))])
    of_rows = np.sqrt(inflation) * rng.normal(size=(5, runs))
    of_weighed = np.sqrt(trust) * rng.normal(size=(2, runs))
    of_prior = np.sqrt(weights * spreads**2)[:, None] * rng.normal(size=(6, runs))
    measured, known = rows.T @ rows, weighed.T @ weighed
    inverse = np.linalg.inv(measured + trust * known + np.diag(weights))
    parts = error_covariance(inverse, rows.T, trust, weighed.T, np.full(6, inflation), weights * spreads)
    for found, larger in ((sum(parts), 1.0), (with_enlarged_prior(sum(parts), parts[1]), 3.0)):
        errors = np.linalg.lstsq(left, np.concatenate([of_rows, of_weighed, larger * of_prior]), rcond=None)[0]
        np.testing.assert_allclose(errors @ errors.T / runs, found, rtol=0, atol=0.05 * np.max(found))


def test_where_the_weight_is_that_of_bayes_from_data_is_the_trace_of_the_resolution_matrix() -> None:
    rng = np.random.default_rng(2)
    fisher, spreads = information(rng, 6, 3), np.full(6, 0.3)
    inverse = np.linalg.inv(fisher + np.diag(spreads**-2.0))
    noise, inherited = error_covariance(
        inverse, Fold(spreads, fisher).root, 1.0, np.zeros((6, 0)), np.ones(6), 1.0 / spreads
    )
    resolution = inverse @ fisher
    found = Uncertainty(noise + inherited, inherited, np.diag(spreads**2), 1.0, np.zeros(len(spreads)), inverse)
    assert found.from_data(slice(0, 6)) == pytest.approx(np.trace(resolution) / 6.0, rel=1e-9)


@pytest.mark.parametrize(("size", "least_told"), [(30.0, 100.0), (0.3, 0.0)], ids=["rounded", "not told"])
def test_a_constant_from_a_grid_leaves_the_errors_that_simulated_ones_have(size: float, least_told: float) -> None:
    """Against least squares of rows whose true constant is between the grid's: told by the rows, so that it is only
    rounded, or anywhere within a step by its prior."""
    rng = np.random.default_rng(3)
    rows, change, runs = rng.normal(size=(40, 3)), size * rng.normal(size=40), 20000
    inverse = np.linalg.inv(rows.T @ rows)
    change = change + size * rows[:, 0]  # what the first column explains of it
    told = float(change @ change - change @ rows @ inverse @ rows.T @ change)
    assert told > least_told
    steps = GridSteps(np.array([1]), (rows.T @ change)[None], np.array([change @ change]))
    nothing_else = Uncertainty(inverse, np.zeros((3, 3)), np.eye(3), 1.0, np.zeros(3), inverse)
    found = nothing_else.with_unknown_constants(steps)
    rounding, by_prior = rng.uniform(-0.5, 0.5, runs), rng.normal(size=runs) / np.sqrt(1.0 + told)
    efforts = rng.normal(size=(40, runs)) + np.outer(change, rounding + by_prior)
    errors = np.linalg.lstsq(rows, efforts, rcond=None)[0]
    np.testing.assert_allclose(errors @ errors.T / runs, found.covariance, rtol=0, atol=0.05 * np.max(found.covariance))
    own = np.diag(found.covariance) - np.diag(inverse)
    np.testing.assert_allclose(found.own_constant, [0.0, own[1], 0.0])


def recorded(rows: FloatArray, residuals: FloatArray, folds: int = 8) -> list[Fold]:
    """Folds of rows ``(N, D)``, in order of time, at the least-squares solution."""
    left = residuals - rows @ np.linalg.lstsq(rows, residuals, rcond=None)[0]
    parts = zip(np.array_split(rows, folds), np.array_split(left, folds), strict=True)
    return [Fold(a.T @ r, a.T @ a) for a, r in parts]


def test_a_direction_in_no_row_is_not_from_data_and_others_become_so_with_more_of_them() -> None:
    rng = np.random.default_rng(0)
    shares = []
    for count in (80, 800, 8000, 80000):
        rows = np.column_stack([0.3 * rng.normal(size=(count, 3)), np.zeros(count)])
        folds = recorded(rows, rng.normal(size=count))
        found = estimate_uncertainty(
            Folds(folds), nothing(4), 1.0, np.full(4, 25.0), np.array([0.2, -0.3, 0.1, 0.0]), one_group(4)
        )
        assert found.from_data(slice(3, 4)) == pytest.approx(0.0, abs=1e-9)
        shares.append(found.from_data(slice(0, 3)))
    assert np.all(np.diff(shares) > 0.0)
    assert shares[-1] > 0.99


@pytest.mark.parametrize(("cutoff", "period"), [(3.0, 0.002), (10.0, 0.02)])
def test_white_noise_through_the_low_pass_counts_as_its_bandwidth(cutoff: float, period: float) -> None:
    """The variance of a mean of filtered noise, by that of as many independent numbers of the same variance."""
    kernel = derivative_kernels(cutoff, period)[0]
    model = arm("arm3", 2).model
    rows = RowSummary(model.channels)
    rows.add(np.zeros((1, 3, model.dimension)), np.full((1, 3), np.nan), elapsed=period)
    expected = np.sum(kernel**2) / np.sum(kernel) ** 2
    assert filtered_fraction(rows, cutoff, WHITE_ROWS_PER_PERIOD) == pytest.approx(expected, rel=0.01)
    assert filtered_fraction(rows, np.inf) == 1.0


def test_rows_written_down_several_times_do_not_shrink_the_interval() -> None:
    """Perfectly correlated errors; counted as independent, the variance would fall by the number of copies."""
    rng, size = np.random.default_rng(3), 20
    ratios = []
    for _ in range(20):
        rows, residuals = rng.normal(size=(1600, size)), rng.normal(size=1600)
        weights = np.full(size, 1e-6)
        once, often = (
            estimate_uncertainty(
                Folds(recorded(np.repeat(rows, count, axis=0), np.repeat(residuals, count))),
                nothing(size),
                1.0,
                weights,
                np.zeros(size),
                one_group(size),
            ).covariance
            for count in (1, 25)
        )
        ratios.append(np.trace(often) / np.trace(once))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_inflation_is_that_of_its_own_kind() -> None:
    """Residuals that change slowly make a constant uncertain, not what changes sign at every sample."""
    rng, count = np.random.default_rng(4), 4000
    rows = np.zeros((count, 20))
    channel = np.arange(count) % 10
    rows[np.arange(count), channel] = 1.0
    rows[np.arange(count), 10 + channel] = np.where(np.arange(count) // 10 % 2, 1.0, -1.0)
    slow = lfilter([1.0], [1.0, -0.9], rng.normal(size=(count // 10, 10)), axis=0) * np.sqrt(1.0 - 0.9**2)
    groups = [ParameterGroup(np.arange(10), 0.2), ParameterGroup(np.arange(10, 20), 0.2)]
    information = rows.T @ rows
    covariance = np.linalg.inv(information + 1e-6 * np.eye(20))
    found = variance_inflation(recorded(rows, slow.ravel()), information, covariance, np.full(20, 1e-6), groups)
    assert 9.0 < found[0] < 29.0  # (1 + 0.9) / (1 - 0.9) in blocks without end
    assert found[10] == 1.0


@pytest.mark.parametrize("precision", [1e2, 1e8])
def test_precise_rows_leave_the_spread_of_what_they_hardly_show(precision: float) -> None:
    """By QR of the rows themselves, which lose nothing: their products lose the half of the digits."""
    rng, size, usual = np.random.default_rng(0), 20, 0.3
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    rows = np.geomspace(precision, 1.0, size // 2)[:, None] * turn[: size // 2]
    targets = rows @ rng.normal(size=size, scale=0.5) + rng.normal(size=size // 2)
    estimate = posterior_by_qr(rows, targets, usual)[0]
    found = estimated_prior_stds(Fold(-estimate / usual**2, rows.T @ rows), -estimate, one_group(size, usual))
    expected = usual
    for _ in range(300):
        mean, determined = posterior_by_qr(rows, targets, expected)
        expected = float(np.sqrt((mean @ mean + usual**2) / (determined + 1.0)))
    assert found[0] == pytest.approx(expected, rel=0.15 if precision > 1e7 else 1e-3)


def test_rows_at_any_distance_leave_a_spread_that_numbers_can_resolve() -> None:
    """Of one direction alone they say that the prior is as far off as one likes."""
    one, usual, distances = np.diag([1e6, 0.0, 0.0]), 0.2, np.array([1.0, 1e3, 1e9])
    found = np.array(
        [
            estimated_prior_stds(Fold(np.zeros(3), one), np.array([distance, 0.0, 0.0]), one_group(3, usual))
            for distance in distances
        ]
    )
    expected = np.minimum(np.sqrt((distances**2 + usual**2) / 2.0), FINEST * usual)
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 3, axis=1), rtol=1e-3)


def posterior_by_qr(rows: FloatArray, targets: FloatArray, spread: float) -> tuple[FloatArray, float]:
    """Mean, with a prior at zero, and the number of directions that the rows determine."""
    size = rows.shape[1]
    basis, factor = np.linalg.qr(np.vstack([spread * rows, np.eye(size)]))
    mean = np.linalg.solve(factor, basis.T @ np.append(targets, np.zeros(size)))
    return spread * mean, size - float(np.sum(np.linalg.inv(factor) ** 2))


@pytest.mark.parametrize("manifold", [ALL, LINKS], ids=["all", "links"])
def test_sensitivities_are_the_derivatives_of_mass_centre_and_central_inertia(manifold: object) -> None:
    """By finite differences of another kind: of a cloud's own sums, moved by congruence."""
    rng = np.random.default_rng(3)
    point = bodies.point(rng, manifold)
    found = physical_sensitivity(point)
    for _ in range(5):
        tangent, step = rng.normal(size=manifold.dimension), 1e-6
        ends = [manifold.exp(point, sign * step * tangent).pseudo_inertias for sign in (1.0, -1.0)]
        ahead, behind = (pseudo_inertia.quantities_of(pseudo_inertia.to_parameters(end)) for end in ends)
        for link in range(manifold.links):
            expected = (ahead - behind)[link] / (2.0 * step)
            along = found[link] @ tangent[manifold.link(link)]
            np.testing.assert_allclose(along, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def errors_of_a_small_ball(size: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors of mass and centre ``(4,)`` of a body at errors of this ``size`` from the prior, a small ball, of which
    only the first moment is measured; their standard deviations by the covariance, and along geodesics."""
    manifold, stds = ParameterManifold(1, 0, np.zeros(0)), np.full(10, size)
    ball = manifold.point(np.array([1.0, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]))
    true = manifold.exp(ball, size * rng.standard_normal(10)).parameters
    rows = np.zeros((10, 10))
    rows[:3, 1:4] = 1e3 / np.linalg.norm(true[1:4]) * np.eye(3)
    augmented = np.column_stack([rows, rows @ true])
    found = trust_region(ResidualObjective(manifold, augmented.T @ augmented, ball, stds**-2.0, 10.0), ball).point
    normals = manifold.whiten(found, rows)
    linear = deviations_of(sensitivity_of_numbers(found)[0], np.linalg.inv(normals.T @ normals + np.diag(stds**-2.0)))
    information = LinksInformation(rows, rows @ (found.parameters - true))
    along = stds_along_geodesics(ball, found, information, stds)[0]
    off = quantities_and_moments(found.parameters) - quantities_and_moments(true)
    off[0] = found.parameters[0] * np.log(found.parameters[0] / true[0])
    return off[:4], linear[:4], along[:4]


def test_deviations_along_geodesics_hold_a_body_far_from_a_placeholder() -> None:
    """The truth is drawn from the prior. For small errors both kinds of deviations are the same."""
    rng = np.random.default_rng(1)
    _, linear, along = errors_of_a_small_ball(0.02, rng)
    np.testing.assert_allclose(along, linear, rtol=0.5)
    off, linear, along = np.swapaxes([errors_of_a_small_ball(2.0, rng) for _ in range(8)], 0, 1)
    assert np.mean(np.abs(off) < 2.0 * linear) < 0.8
    assert np.mean(np.abs(off) < 2.0 * along) > 0.85


def test_the_variance_of_what_is_known_well_is_not_lost_beside_what_is_not() -> None:
    """``x' H^-1 x`` is the difference of huge numbers, and may become negative; the root keeps it."""
    rng = np.random.default_rng(2)
    known, weights = rng.standard_normal((3, 8)), np.full(8, 1e-12)
    root = information_inverse_root(1e4 * known.T @ known, weights)
    found = np.linalg.norm(known @ root, axis=1)
    np.testing.assert_allclose(found, 1e-2, rtol=1e-4)
    np.testing.assert_allclose(root @ root.T, information_inverse(1e4 * known.T @ known, weights))


def test_a_prior_that_is_drawn_beyond_what_rounding_allows_is_where_the_search_begins() -> None:
    """A body of which hardly anything is known, as a payload whose size is a guess."""
    manifold, rows = ParameterManifold(1, 0, np.zeros(0)), 1e-6 * np.eye(10)
    ball = manifold.point(np.array([1.0, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]))
    far = manifold.exp(ball, 5.0 * np.random.default_rng(3).standard_normal(10))
    along = stds_along_geodesics(ball, far, LinksInformation(rows, np.zeros(10)), np.full(10, 8.0))
    assert np.all(np.isfinite(along))


# --- what it says of an arm -----------------------------------------------------------------------------------------


def solved(case: Case, coefficients: FloatArray, targets: FloatArray, gamma: float | None = None) -> Estimate:
    return estimate(case.model, summary(case.model, coefficients, targets), EstimatorSettings(gamma=gamma))


# --- how often it is right ------------------------------------------------------------------------------------------


@cache
def runs() -> list[tuple[Case, FloatArray, Estimate]]:
    """Independent robots of one kind, one motion, noise low-passed by ``x' = CORRELATION x + white``.

    The prior's weight is the one that the first run chooses.
    """
    case = arm("arm3", 7, seconds=10)
    coefficients = case.model.rows(case.samples).coefficients
    rng, gamma, found = np.random.default_rng(7), None, list[tuple[Case, FloatArray, Estimate]]()
    for _ in range(RUNS):
        planted = parameters_of(case.model, truth(rng, case.model.robot))
        white = rng.normal(size=(len(coefficients) + 500, len(case.model.channels)))
        noise = lfilter([1.0], [1.0, -CORRELATION], white, axis=0)[500:] * np.sqrt(1.0 - CORRELATION**2)
        estimated = solved(case, coefficients, coefficients @ planted + NOISE * noise, gamma)
        gamma = estimated.gamma
        found.append((case, planted, estimated))
    return found


def coverage() -> dict[str, float]:
    """How often the truth lies within 1.96 standard deviations: effects by name, links' quantities told or not."""
    inside: dict[str, list[bool]] = defaultdict(list)
    for case, planted, found in runs():
        first = len(case.model.nominal_inertias)
        exact_drives = np.ones(len(case.model.channels))
        for effect, true in zip(found.effects, [*planted[first:], *exact_drives], strict=True):
            if effect.from_data > 0.75:
                inside[effect.name].append(abs(effect.value - true) < 1.96 * effect.std)
        for link, true in zip(found.links, planted[:first].reshape(-1, 10), strict=True):
            expected = pseudo_inertia.quantities_of(true)
            for quantity, value, std, target in zip(QUANTITIES, link.quantities, link.std, expected, strict=True):
                told = "untold" if quantity in link.cannot_tell else "told"
                inside[told].append(abs(value - target) < 1.96 * std)
    return {kind: float(np.mean(hits)) for kind, hits in inside.items()}


KINDS = {*ALL_EFFECTS, "drive_gain", "told", "untold"}


def test_intervals_of_95_percent_hold_the_truth_about_that_often_under_low_passed_noise() -> None:
    """At least so often: of 60 intervals of an effect, fewer than 0.85 do once in a thousand times. Those of one link
    depend on each other."""
    found = coverage()
    assert set(found) == KINDS
    assert min(found.values()) >= 0.85, found


def test_deviations_of_predicted_efforts_are_those_of_robots_drawn_from_the_posterior() -> None:
    case = arm("arm3", 2)
    rows = case.model.rows(case.samples)
    rng = np.random.default_rng(11)
    found = solved(case, rows.coefficients, rows.targets + NOISE * rng.normal(size=rows.targets.shape))
    few = case.samples.select(slice(0, 400, 10))
    drawn = found.posterior.draw(4000, rng, 0.1)  # so narrow that none is cut off
    _, efforts = case.model.predict(few, drawn.T)
    np.testing.assert_allclose(10.0 * np.std(efforts, axis=2), effort_deviations(case.model, few, found), rtol=0.07)


def test_the_joint_covariance_holds_the_truth_along_straight_lines_and_not_along_geodesics() -> None:
    """Squared distances of the truth in variances, per direction: near one in all directions together."""
    straight, geodesic = [], []
    for _, planted, found in runs():
        posterior = found.posterior
        away = posterior.coordinates(planted)
        along = posterior.manifold.log(posterior.point, posterior.manifold.point(planted))
        for errors, kept in ((away, straight), (along, geodesic)):
            kept.append(errors @ np.linalg.solve(posterior.covariance, errors) / len(errors))
    assert 0.7 < np.mean(straight) < 1.4
    assert np.mean(geodesic) > 2.0 * np.mean(straight)


def test_correlations_longer_than_a_fold_are_seen() -> None:
    """Folds that come in equal pairs are half as many."""
    rng = np.random.default_rng(4)
    slopes = 1e-3 * rng.normal(size=(8, 6))

    def factor(slopes: FloatArray) -> float:
        folds = Folds([Fold(slope, np.eye(6)) for slope in slopes])
        spreads, groups = np.full(6, 0.2), one_group(6)
        return (
            1.0 / estimate_uncertainty(folds, nothing(6), 1.0, spreads**-2.0, np.zeros(6), groups).independent_fraction
        )

    scaled = 1e3 * slopes
    assert factor(np.repeat(scaled, 2, axis=0)) > 1.5 * max(1.0, factor(np.tile(scaled, (2, 1))))


def test_what_gravity_loads_is_as_unsure_as_gravity() -> None:
    """By the share of it that an accelerometer's bias is; what is estimated stays the same."""
    case, share = arm("arm3", 0, noise=NOISE), 0.05
    exact, unsure = (identifier(case, relative_mass_std=std).solve() for std in (0.0, share))
    np.testing.assert_array_equal(unsure.parameters, exact.parameters)
    size = len(case.model.nominal_inertias)
    still = with_values(case.samples, velocity=0.0 * case.samples.velocity, acceleration=0.0 * case.samples.velocity)
    rows = case.model.rows(still).coefficients[::50, :, :size]
    before, after = (
        np.einsum("nci,ij,ncj->nc", rows, found.posterior.parameter_covariance[:size, :size], rows)
        for found in (exact, unsure)
    )
    efforts = rows @ exact.parameters[:size]
    np.testing.assert_allclose(
        np.sqrt(after - before), share * np.abs(efforts), atol=0.02 * share * np.max(np.abs(efforts))
    )
    deviations = [found.posterior.parameter_covariance[:size, :size].diagonal() for found in (exact, unsure)]
    added = np.sqrt(np.maximum(deviations[1] - deviations[0], 0.0))[-10:] / np.abs(exact.parameters[size - 10 : size])
    np.testing.assert_allclose(added[:4], share, rtol=0.4)
    assert np.max(added[4:]) < 0.4 * share, "no gravity turns a body"
