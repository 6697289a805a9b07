"""Both solvers end at the same minimum of the same objective, downhill all the way, wherever they start nearby."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from geometry import bodies

from geomid_ros.estimation.objective import Evaluation, Objective
from geomid_ros.estimation.solvers import SOLVERS, Extrapolation, Solution, cyclic, quadratic_minimiser, trust_region
from geomid_ros.geometry import projection
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

from .problems import ALL, LINKS, Problem, human_like, problem

BOTH = pytest.mark.parametrize("kind", ["geodesic", "residual"])
GAMMA = 1e-2
SAME_POINT = 1e-6  # geodesic distance


def solved(problem: Problem, kind: str, gamma: float = GAMMA, tolerance: float = 1e-9) -> tuple[Objective, Solution]:
    objective = getattr(problem, kind)(gamma)
    return objective, trust_region(objective, problem.prior, tolerance)


def projections(problem: Problem, point: Point) -> list[Point]:
    """The projected points of all rows, Proposition 2."""
    manifold = problem.manifold
    found = projection.project(manifold, point, manifold.whiten(point, problem.rows), problem.targets)
    assert np.all(found.status == projection.ROOT)
    return [manifold.exp(point, tangent) for tangent in found.tangent]


def assert_descending(solution: Solution) -> None:
    """The last steps may lie within rounding of each other."""
    values = np.array(solution.values)
    assert np.all(np.diff(values) <= 1e-13 * values[:-1])
    assert np.all(np.diff(values)[:-3] < 0.0)


@BOTH
@pytest.mark.parametrize("solver", SOLVERS)
def test_every_step_descends(solver: str, kind: str) -> None:
    for case in (problem(1, ALL), human_like(1)):
        objective = getattr(case, kind)(GAMMA)
        solution = SOLVERS[solver](objective, case.prior, max_steps=50)
        assert_descending(solution)
        assert solution.values[0] == objective.evaluate(case.prior).value
        assert solution.values[-1] == solution.evaluation.value
        assert len(solution.values) == solution.steps + 1


@BOTH
def test_the_end_is_stationary_and_a_minimum(kind: str) -> None:
    for case in (problem(1, ALL), human_like(1)):
        objective, solution = solved(case, kind)
        assert solution.converged
        assert np.linalg.norm(solution.evaluation.gradient) <= 1e-9 * objective.scale
        assert np.linalg.eigvalsh(solution.evaluation.hessian)[0] > 0.0
        rng = np.random.default_rng(1)
        for distance in (1e-3, 0.1, 1.0):
            for _ in range(10):
                near = bodies.near(rng, case.manifold, solution.point, distance)
                assert objective.evaluate(near).value > solution.evaluation.value


def test_the_minimum_of_19_is_a_fixed_point_of_projection_and_karcher_mean() -> None:
    """The alternation of the paper as printed: slack variables by (21), (22), then the mean (23).

    The half of a squared distance has no curvature below 1 (P(4) is of non-positive curvature): a point at which the
    weighted mean of the logarithms has the length l is no farther than l from the Karcher mean.
    """
    case = problem(1, LINKS, count=25, distance=0.3)
    objective, solution = solved(case, "geodesic", tolerance=1e-11)
    assert not np.any(objective.set_aside)
    points = [*projections(case, solution.point), case.prior]
    weights = np.append(objective.weights, objective.prior_weight)
    logs = np.array([case.manifold.log(solution.point, point) for point in points])
    assert np.linalg.norm(weights @ logs / np.sum(weights)) < SAME_POINT


def test_a_cycle_is_the_first_karcher_step_from_the_projections() -> None:
    case = problem(1, LINKS, count=25, distance=0.3)
    objective = case.geodesic(GAMMA)
    one = cyclic(objective, case.prior, max_steps=1)
    weights = np.append(objective.weights, objective.prior_weight)
    logs = [case.manifold.log(case.prior, point) for point in [*projections(case, case.prior), case.prior]]
    step = weights @ np.array(logs) / np.sum(weights)
    assert case.manifold.distance(one.point, case.manifold.exp(case.prior, step)) < 1e-9


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_reals_have_no_origin_and_no_unit(scale: float) -> None:
    """With flat blocks alone both objectives are ridge regression, whose solution is linear algebra."""
    rng = np.random.default_rng(0)
    manifold = ParameterManifold(0, 0, scale * np.array([1.0, 2.0, 5.0]))
    prior = manifold.point(scale * rng.normal(size=3))
    rows = rng.normal(size=(20, 3))
    targets = rows @ prior.parameters + scale * rng.normal(size=20)
    case = Problem(manifold, prior, prior, rows, targets, np.full(20, 0.3 * scale))
    weights = np.sum((rows * manifold.scales) ** 2, axis=1) / case.sigmas**2
    ridge = GAMMA * np.sum(weights) * np.diag(manifold.scales**-2.0)
    normal = rows.T @ rows / case.sigmas[0] ** 2 + ridge
    expected = np.linalg.solve(normal, rows.T @ targets / case.sigmas[0] ** 2 + ridge @ prior.parameters)
    for kind in ("geodesic", "residual"):
        _, solution = solved(case, kind)
        np.testing.assert_allclose(solution.point.parameters, expected, rtol=1e-7)


@pytest.mark.parametrize(
    ("how", "solver", "kind"),
    [
        ("decomposition", "trust_region", "residual"),
        ("numbers", "trust_region", "geodesic"),
        ("numbers", "cyclic", "residual"),
    ],
)
def test_trial_points_that_overflow_shorten_the_step(
    how: str, solver: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fault 109: beyond some distance nothing can be evaluated; the minimum, which is nearer, is found all the same."""
    case = problem(1, ALL)
    objective, expected = solved(case, kind)
    evaluate, overflows = type(objective).evaluate, []

    def limited(self: Objective, point: Point) -> Evaluation:
        if self.manifold.distance(case.prior, point) <= 1.2 * self.manifold.distance(case.prior, expected.point):
            return evaluate(self, point)
        overflows.append(point)
        if how == "decomposition":
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return replace(evaluate(self, point), value=np.nan)

    monkeypatch.setattr(type(objective), "evaluate", limited)
    found = SOLVERS[solver](objective, case.prior, 1e-6)
    assert objective.manifold.distance(found.point, expected.point) < 1e-3
    step = type(objective).step
    monkeypatch.setattr(type(objective), "step", lambda self, point, tangent: step(self, point, _longer(tangent)))
    longer = SOLVERS[solver](objective, case.prior, 1e-6, max_steps=20)
    assert overflows, "steps that are made longer go too far"
    assert longer.values[-1] <= longer.values[0]
    assert np.isfinite(longer.values).all()


def test_where_rounding_hides_the_descent_below_zero_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding can make a sum of squares of huge parts less than zero."""
    case = problem(1, ALL)
    objective = case.residual(GAMMA)
    evaluate = type(objective).evaluate
    monkeypatch.setattr(
        type(objective), "evaluate", lambda self, point: replace(evaluate(self, point), value=-1e6 * self.scale)
    )
    solution = trust_region(objective, case.prior)
    assert solution.reason == "no decrease left in rounding"


def _longer(tangent: FloatArray) -> FloatArray:
    """A thousand times as long, if it is not short."""
    return 1000.0 * tangent if np.linalg.norm(tangent) > 1e-4 else tangent


def in_the_ball(hessian: FloatArray, gradient: FloatArray, radius: float) -> float:
    """The least value of ``g x + x H x / 2`` in the ball, in the eigenbasis by bisection (More & Sorensen 1983)."""
    values, basis = np.linalg.eigh(hessian)
    components = basis.T @ gradient

    def step(damping: float) -> FloatArray:
        return np.asarray(-(basis @ (components / (values + damping))))

    low = max(0.0, 1e-12 - float(values[0]))
    high = low + float(np.linalg.norm(gradient)) / radius
    if np.linalg.norm(step(low)) <= radius:
        high = low
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(step(middle)) > radius else (low, middle)
    best = step(high)
    return float(gradient @ best + 0.5 * best @ hessian @ best)


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("least", [1.0, 1e-6, 0.0, -1.0, -1e4])
def test_a_step_is_nearly_the_best_in_its_ball(radius: float, least: float) -> None:
    """Whether the Hessian, whose condition is large, is positive definite or not."""
    rng = np.random.default_rng(1)
    turned = np.linalg.qr(rng.normal(size=(12, 12)))[0]
    hessian = (turned * np.append(least, 10.0 ** rng.uniform(-1.0, 6.0, size=11))) @ turned.T
    gradient = rng.normal(size=12) * 10.0 ** rng.uniform(-3.0, 3.0)
    hessian = 0.5 * (hessian + hessian.T)
    step = quadratic_minimiser(Evaluation(0.0, gradient, hessian, hessian), radius)
    assert np.linalg.norm(step) <= radius
    value = gradient @ step + 0.5 * step @ hessian @ step
    assert value <= 0.97 * in_the_ball(hessian, gradient, radius)


def test_a_gradient_that_does_not_say_which_way_down_still_gives_a_step() -> None:
    hessian, gradient = np.diag([-1.0, 2.0, 5.0]), np.array([0.0, 1.0, 1.0])
    step = quadratic_minimiser(Evaluation(0.0, gradient, hessian, hessian), 10.0)
    np.testing.assert_allclose(step, [0.0, -1.0 / 3.0, -1.0 / 6.0], rtol=2e-3)


@pytest.mark.parametrize("least", [0.0, -6e-14])
def test_a_parameter_of_which_nothing_is_known_ends_no_step_never(least: float) -> None:
    """Neither curvature nor slope along it: damping that is next to nothing is the least there is."""
    hessian, gradient = np.diag([least, 1.0, 5e5]), np.array([0.0, 1.0, 700.0])
    step = quadratic_minimiser(Evaluation(0.0, gradient, hessian, hessian), 16.0)
    np.testing.assert_allclose(step, [0.0, -1.0, -700.0 / 5e5], rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize(("slope", "bend"), [(1.0, np.nan), (np.inf, 1.0), (np.nan, 1.0)])
def test_where_derivatives_are_not_finite_there_is_no_step(slope: float, bend: float) -> None:
    hessian = np.diag([1.0, bend])
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        quadratic_minimiser(Evaluation(0.0, np.array([slope, 1.0]), hessian, hessian), 1.0)


def test_a_linear_iteration_is_at_its_fixed_point_after_one_round_more_than_it_has_dimensions() -> None:
    """From as near as an iteration is linear."""
    rng = np.random.default_rng(1)
    size = 4
    basis = rng.standard_normal((size, size))
    matrix = basis @ np.diag(rng.uniform(0.3, 0.9, size)) @ np.linalg.inv(basis)
    shift = 0.01 * rng.standard_normal(size)
    exact = np.linalg.solve(np.eye(size) - matrix, shift)
    extrapolation, begun = Extrapolation(), np.zeros(size)
    for _ in range(size + 1):
        begun = extrapolation.next(begun, matrix @ begun + shift)
    np.testing.assert_allclose(begun, exact, rtol=1e-6, atol=1e-6 * float(np.linalg.norm(exact)))
    extrapolation = Extrapolation()
    for _ in range(10):
        np.testing.assert_array_equal(extrapolation.next(exact, exact), exact)


def test_what_is_not_linear_at_all_is_not_extrapolated_far() -> None:
    extrapolation = Extrapolation()
    extrapolation.next(np.array([0.0]), np.array([1.0]))
    ended = np.array([2.0])
    np.testing.assert_array_equal(extrapolation.next(np.array([1.001]), ended), ended)
