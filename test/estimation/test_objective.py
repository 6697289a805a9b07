"""The value of (19) and of Remark 3 by an independent route, and their derivatives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from geometry import bodies
from scipy.linalg import eigvalsh, expm, sqrtm
from scipy.optimize import minimize

from geomid_ros.estimation.objective import Objective, products_at, row_weights
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

from .problems import ALL, LINKS, Problem, problem

pytestmark = pytest.mark.usefixtures("either")
BOTH = pytest.mark.parametrize("kind", ["geodesic", "residual"])
SMALL = ParameterManifold(1, 1, np.array([0.1]))
GAMMA = 0.03
NUMERICAL_MINIMUM = 1e-6
ROUNDING = 1e-11


def built(problem: Problem, kind: str, gamma: float = GAMMA) -> Objective:
    return getattr(problem, kind)(gamma)


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    mass, first, inertia = parameters[0], parameters[1:4], np.zeros((3, 3))
    for pair, value in zip(bodies.PINOCCHIO_PAIRS, parameters[4:10], strict=True):
        inertia[pair] = inertia[pair[::-1]] = value
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.block([[second, first[:, None]], [first[None], np.array([[mass]])]])


def moved(parameters: FloatArray, step: FloatArray) -> FloatArray:
    """The end of a geodesic of SMALL, by scipy: ten entries of a symmetric matrix, one logarithm, one real."""
    entries = np.zeros((4, 4))
    entries[np.triu_indices(4)] = step[:10]
    root = sqrtm(pseudo_inertia(parameters)).real
    pseudo = root @ expm(entries + np.triu(entries, 1).T) @ root
    second = pseudo[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    inertial = [pseudo[3, 3], *pseudo[:3, 3], *(inertia[pair] for pair in bodies.PINOCCHIO_PAIRS)]
    return np.array([*inertial, parameters[10] * np.exp(step[10]), parameters[11] + SMALL.scales[0] * step[11]])


def squared_length(step: FloatArray) -> float:
    off_diagonal = np.not_equal(*np.triu_indices(4))
    return float(np.sum(step**2) + np.sum(step[:10][off_diagonal] ** 2))


def squared_distance(a: FloatArray, b: FloatArray) -> float:
    """Between two parameter vectors of SMALL, by (9)."""
    eigenvalues = eigvalsh(pseudo_inertia(b), pseudo_inertia(a))
    return float(
        np.sum(np.log(eigenvalues) ** 2) + np.log(b[10] / a[10]) ** 2 + ((b[11] - a[11]) / SMALL.scales[0]) ** 2
    )


def distance_to_hyperplane(parameters: FloatArray, row: FloatArray, target: float, length: float) -> float:
    """Squared, by constrained minimisation over the end of the geodesic."""
    found = minimize(
        squared_length,
        np.zeros(12),
        method="SLSQP",
        constraints={"type": "eq", "fun": lambda step: (row @ moved(parameters, step) - target) / length},
        options={"ftol": 1e-14, "maxiter": 300},
    )
    assert abs(row @ moved(parameters, found.x) - target) <= 1e-7 * length
    return float(found.fun)


def metric(prior: Point, manifold: ParameterManifold) -> FloatArray:
    """M of Remark 2 by its definition, ``tr(P^-1 f(e_k) P^-1 f(e_l))`` per link."""
    matrix = np.zeros((manifold.dimension, manifold.dimension))
    for link, pseudo in enumerate(prior.pseudo_inertias):
        units = [np.linalg.solve(pseudo, pseudo_inertia(unit)) for unit in np.eye(10)]
        block = np.array([[np.trace(a @ b) for a in units] for b in units])
        matrix[manifold.link(link), manifold.link(link)] = block
    start = manifold.inertial.stop
    matrix[start:, start:] = np.diag(np.concatenate([prior.positives**-2.0, manifold.scales**-2.0]))
    return matrix


@cache
def minimised(case: Problem, here: Point) -> float:
    """The value of (19), each squared distance minimised numerically."""
    weights = np.einsum("ni,ij,nj->n", case.rows, np.linalg.inv(metric(case.prior, SMALL)), case.rows) / case.sigmas**2
    lengths = np.linalg.norm(SMALL.whiten(here, case.rows), axis=1)
    distances = [
        distance_to_hyperplane(here.parameters, row, target, length)
        for row, target, length in zip(case.rows, case.targets, lengths, strict=True)
    ]
    prior = GAMMA * np.sum(weights) * squared_distance(here.parameters, case.prior.parameters)
    return float(0.5 * (weights @ np.array(distances) + prior))


FEW = problem(1, SMALL, count=3, noise=0.1, distance=0.5)
BESIDE = bodies.near(np.random.default_rng(1), SMALL, FEW.prior, 0.2)


def test_19_is_the_weighted_sum_of_numerically_minimised_squared_distances() -> None:
    objective = FEW.geodesic(GAMMA)
    assert not np.any(objective.set_aside)
    assert objective.evaluate(BESIDE).value == pytest.approx(minimised(FEW, BESIDE), rel=NUMERICAL_MINIMUM)


def test_remark_3_is_the_squared_residual_and_the_weighted_distance_from_the_prior() -> None:
    case = problem(1, SMALL, count=20)
    weights = np.einsum("ni,ij,nj->n", case.rows, np.linalg.inv(metric(case.prior, SMALL)), case.rows) / case.sigmas**2
    squares = ((case.rows @ case.truth.parameters - case.targets) / case.sigmas) ** 2
    prior = GAMMA * np.sum(weights) * squared_distance(case.prior.parameters, case.truth.parameters)
    found = case.residual(GAMMA).evaluate(case.truth).value
    assert found == pytest.approx(0.5 * (np.sum(squares) + prior), rel=1e-9)


def test_the_weights_are_those_of_remark_2() -> None:
    case = problem(1, ALL)
    inverse = np.linalg.inv(metric(case.prior, ALL))
    expected = np.einsum("ni,ij,nj->n", case.rows, inverse, case.rows) / case.sigmas**2
    np.testing.assert_allclose(row_weights(ALL, case.prior, case.rows, case.sigmas), expected, rtol=1e-7)
    objective = case.geodesic(GAMMA)
    np.testing.assert_allclose(objective.weights, expected, rtol=1e-7)
    for kind in ("geodesic", "residual"):
        np.testing.assert_allclose(built(case, kind).prior_weights, GAMMA * np.sum(expected), rtol=1e-7)
        assert built(case, kind).scale == pytest.approx((1.0 + GAMMA) * np.sum(expected), rel=1e-7)


@BOTH
@pytest.mark.parametrize("manifold", [ALL, LINKS], ids=["all", "links"])
def test_the_gradient_is_that_of_the_value_along_geodesics(manifold: ParameterManifold, kind: str) -> None:
    case = problem(1, manifold, count=30, noise=0.2)
    objective = built(case, kind)
    here = bodies.near(np.random.default_rng(1), manifold, case.prior, 0.8)
    gradient, step = objective.evaluate(here).gradient, 1e-5
    numerical = np.empty(manifold.dimension)
    for k, unit in enumerate(np.eye(manifold.dimension)):
        ahead, behind = (objective.evaluate(manifold.exp(here, sign * step * unit)).value for sign in (1.0, -1.0))
        numerical[k] = (ahead - behind) / (2.0 * step)
    np.testing.assert_allclose(gradient, numerical, rtol=0, atol=1e-6 * np.linalg.norm(gradient))


@BOTH
@pytest.mark.parametrize("manifold", [ALL, LINKS], ids=["all", "links"])
def test_the_hessian_is_the_second_derivative_along_steps(manifold: ParameterManifold, kind: str) -> None:
    case = problem(1, manifold, count=30, noise=0.2)
    objective, rng = built(case, kind), np.random.default_rng(1)
    here = bodies.near(rng, manifold, case.prior, 0.8)
    at_rest, step = objective.evaluate(here), 1e-3
    np.testing.assert_allclose(at_rest.hessian, at_rest.hessian.T, rtol=0, atol=ROUNDING * objective.scale)
    for _ in range(20):
        direction = rng.normal(size=manifold.dimension)
        direction /= np.linalg.norm(direction)
        ahead, behind = (
            objective.evaluate(objective.step(here, sign * step * direction)).value for sign in (1.0, -1.0)
        )
        numerical = (ahead - 2.0 * at_rest.value + behind) / step**2
        assert direction @ at_rest.hessian @ direction == pytest.approx(numerical, abs=1e-5 * objective.scale)


def test_products_of_rows_of_few_links_are_those_of_all_columns() -> None:
    """Also their weights (Remark 2) follow from the products."""
    given = problem(3, ParameterManifold(4, 2, np.array([0.1, 20.0])), count=40)
    manifold, prior, rows = given.manifold, given.prior, given.rows.copy()
    for link in range(4):  # rows of one link, of two, and of all
        rows[5 * link : 5 * link + 5 + 5 * link, manifold.link(link)] = 0.0
    off = rows @ prior.parameters - given.targets
    dense = np.column_stack([manifold.offset_rows(prior, rows), off])
    products = products_at(manifold, prior, rows, given.targets)
    assert np.allclose(products, dense.T @ dense, rtol=0.0, atol=ROUNDING * np.max(np.abs(dense)) ** 2)
    scales = np.append(np.ones(manifold.inertial.stop), manifold.jacobian(prior)[1])
    assert np.isclose(np.diag(products)[:-1] @ scales**2, np.sum(row_weights(manifold, prior, rows)), rtol=ROUNDING)
