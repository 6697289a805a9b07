"""``solve_rows``: what the paper promises of its estimator, on rows with a planted truth."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation import paper_estimator
from geomid_ros.estimation.paper_estimator import solve_rows
from geomid_ros.types import FloatArray

from .problems import LINKS, Problem, human_like, problem

NEAR = 1e-8  # the tolerance of solve_rows: geodesic distance of a result from the minimum
ROD = np.array([[2.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]])


def solution(problem: Problem, gamma: float, *, exact: bool = True) -> FloatArray:
    return solve_rows(problem.rows, problem.targets, problem.sigmas, problem.prior_table, gamma, exact=exact).parameters


def distance(problem: Problem, a: FloatArray, b: FloatArray) -> float:
    return problem.manifold.distance(problem.manifold.point(a.ravel()), problem.manifold.point(b.ravel()))


@pytest.mark.parametrize("exact", [True, False], ids=["exact", "principal"])
def test_exact_rows_return_the_truth_and_a_strong_prior_itself(exact: bool) -> None:
    """The rows tell everything. The prior's pull vanishes in proportion to gamma, that of the rows to its inverse."""
    case = problem(1, LINKS, count=60, noise=0.0)
    for there, gammas in ((case.truth, (1e-4, 1e-6, 1e-8)), (case.prior, (1e2, 1e4, 1e6))):
        errors = [distance(case, solution(case, gamma, exact=exact), there.parameters) for gamma in gammas]
        assert errors[2] < 1e-5
        assert errors[2] < 0.02 * errors[1] < 4e-4 * errors[0]


def test_principal_rows_have_the_content_of_all() -> None:
    """The same residuals but for a constant, the same sum of weights, and orthogonal in tangent coordinates."""
    case = human_like(1)
    augmented = np.column_stack([case.rows, case.targets]) / case.sigmas[:, None]
    principal = np.column_stack(paper_estimator.principal_rows(case.manifold, case.prior, augmented))
    assert len(principal) <= case.manifold.dimension < len(augmented)
    points = [np.append(point.parameters, -1.0) for point in (case.truth, case.prior)]
    off = [np.sum((augmented @ point) ** 2) - np.sum((principal @ point) ** 2) for point in points]
    assert off[0] == pytest.approx(off[1], rel=1e-6)
    assert off[0] > 0.0
    whitened = case.manifold.whiten(case.prior, principal[:, :-1])
    weights = np.diag(whitened @ whitened.T)
    np.testing.assert_allclose(whitened @ whitened.T, np.diag(weights), atol=1e-9 * np.max(weights))
    assert np.sum(weights) == pytest.approx(np.sum(case.manifold.whiten(case.prior, augmented[:, :-1]) ** 2))


def test_rows_without_a_projection_are_set_aside_and_counted() -> None:
    case = problem(1, LINKS, count=20)
    rows = np.concatenate([np.eye(1, 20), case.rows, np.zeros((1, 20))])
    targets = np.concatenate([[-3.0], case.targets, [1.0]])  # a negative mass; nothing that should be one
    sigmas = np.concatenate([[0.1], case.sigmas, [0.1]])
    found = solve_rows(rows, targets, sigmas, case.prior_table, 1e-2, exact=True)
    np.testing.assert_array_equal(np.flatnonzero(found.set_aside), [0, 21])
    assert distance(case, found.parameters, solution(case, 1e-2)) < 2.0 * NEAR


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"rows": np.ones((3, 9))}, r"\(3, 9\)"),
        ({"rows": np.ones((2, 10))}, r"\(2, 10\)"),
        ({"targets": np.ones((3, 1))}, r"\(3, 1\)"),
        ({"prior": np.ones((1, 9))}, r"\(1, 9\)"),
        ({"sigmas": np.ones(2)}, r"\(2,\)"),
        ({"sigmas": np.array([1.0, -1.0, 1.0])}, "standard deviations"),
        ({"rows": np.full((3, 10), np.nan)}, "rows"),
        ({"prior": -ROD}, "link 0"),
        ({"prior": np.concatenate([ROD, 0.0 * ROD]), "rows": np.ones((3, 20))}, "link 1"),
        ({"gamma": 0.0}, "gamma"),
        ({"gamma": np.nan}, "gamma"),
        ({"solver": "newton"}, "cyclic, trust_region"),
    ],
)
def test_bad_input_is_refused_by_name(change: dict[str, object], named: str) -> None:
    usual = {"rows": np.ones((3, 10)), "targets": np.ones(3), "sigmas": 1.0, "prior": ROD}
    with pytest.raises(InputError, match=named):
        solve_rows(**(usual | change))


@pytest.mark.parametrize("objective", ["geodesic", "residual"])
def test_the_weight_that_is_chosen_predicts_fresh_rows_nearly_as_well_as_the_best(objective: str) -> None:
    case = human_like(1)
    fitted = slice(0, 2 * len(case.rows) // 3)
    fresh = slice(2 * len(case.rows) // 3, None)

    def error(gamma: float | None) -> float:
        rows, targets, sigmas = case.rows[fitted], case.targets[fitted], case.sigmas[fitted]
        found = solve_rows(rows, targets, sigmas, case.prior_table, gamma, tolerance=1e-5, objective=objective)
        assert gamma is None or found.gamma == gamma
        left = case.rows[fresh] @ found.parameters.ravel() - case.targets[fresh]
        return float(np.sqrt(np.mean((left / case.sigmas[fresh]) ** 2)))

    best = min(error(gamma) for gamma in 10.0 ** -np.arange(1.0, 6.5, 0.5))
    assert error(None) < 1.15 * best


def test_the_best_weight_is_the_minimum_of_a_parabola_through_the_logarithms() -> None:
    decades = np.arange(1.0, 7.0)
    for minimum in (2.6, 3.0, 4.4):
        losses = np.exp((decades - minimum) ** 2)
        assert np.log10(paper_estimator.best_weight(list(losses))) == pytest.approx(-minimum)
        assert paper_estimator.best_weight(list(losses[:5])) == pytest.approx(paper_estimator.best_weight(list(losses)))
    assert paper_estimator.best_weight([1.0, 1.1]) == 0.1
