"""The gradient and the Hessian of the half squared distance, by moving the point and projecting anew."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry import projection
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.projection import NO_ROOT_HIGH, NO_ROOT_LOW, ROOT
from geomid_ros.types import FloatArray

from . import bodies
from .planes import (
    ALL,
    LINK,
    POSITIVE,
    SHAPES,
    beyond,
    neighbourhood,
    one,
    problem,
    project,
    row_of,
)

pytestmark = pytest.mark.usefixtures("either")

FIRST_DIFFERENCE = 1e-6
SECOND_DIFFERENCE = 1e-5
ROUNDING = 1e-9


def half_squared_along(
    manifold: ParameterManifold, point: Point, rows: FloatArray, targets: FloatArray, velocity: FloatArray
) -> FloatArray:
    return project(manifold, manifold.exp(point, velocity), rows, targets).half_squared


def check_gradient(manifold: ParameterManifold, point: Point, rows: FloatArray, targets: FloatArray) -> None:
    found = project(manifold, point, rows, targets)
    rng, h = np.random.default_rng(0), 1e-5
    for v in rng.normal(size=(4, manifold.dimension)):
        after, before = (half_squared_along(manifold, point, rows, targets, t * v) for t in (h, -h))
        slopes, scale = -found.tangent @ v, np.linalg.norm(found.tangent, axis=1) * np.linalg.norm(v) + 1.0
        np.testing.assert_allclose((after - before) / (2.0 * h) / scale, slopes / scale, rtol=0, atol=FIRST_DIFFERENCE)


def slope_along(
    manifold: ParameterManifold, point: Point, row: FloatArray, target: FloatArray, velocity: FloatArray, t: float
) -> float:
    """Derivative of the half squared distance at time t of a geodesic, by the gradient there."""
    here = manifold.exp(point, t * velocity)
    onward = manifold.log(here, manifold.exp(point, (t + 1.0) * velocity))
    return -float(project(manifold, here, row, target).tangent[0] @ onward)


def check_hessian(manifold: ParameterManifold, point: Point, rows: FloatArray, targets: FloatArray) -> None:
    """Every row by itself: the second derivative along geodesics is a difference of slopes (fourth order)."""
    rng, h = np.random.default_rng(0), 1e-4
    for row, target in zip(rows[:, None], targets[:, None], strict=True):
        found = project(manifold, point, row, target)
        hessian = np.outer(found.direction[0], found.direction[0]) + found.curvature
        np.testing.assert_allclose(found.curvature, found.curvature.T, rtol=0, atol=0)
        for v in rng.normal(size=(3, manifold.dimension)) / np.sqrt(manifold.dimension):
            slopes = [slope_along(manifold, point, row, target, v, k * h) for k in (-2, -1, 1, 2)]
            second = (slopes[0] - 8.0 * slopes[1] + 8.0 * slopes[2] - slopes[3]) / (12.0 * h)
            assert v @ hessian @ v == pytest.approx(second, rel=SECOND_DIFFERENCE, abs=SECOND_DIFFERENCE)


@SHAPES
def test_derivatives_within_the_neighbourhood(manifold: ParameterManifold) -> None:
    check_gradient(manifold, *neighbourhood(1, manifold))
    point, rows, targets = problem(1, manifold, 10, 0.4)
    assert np.all(project(manifold, point, rows, targets).status == ROOT)
    check_hessian(manifold, point, rows, targets)


@pytest.mark.parametrize("status", [NO_ROOT_LOW, NO_ROOT_HIGH])
@SHAPES
def test_derivatives_beyond_the_neighbourhood(manifold: ParameterManifold, status: int) -> None:
    check_gradient(manifold, *beyond(1, manifold, status))
    check_hessian(manifold, *beyond(1, manifold, status))


@pytest.mark.parametrize("inside", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-15, 0.0])
def test_hessian_up_to_the_end_of_the_neighbourhood(inside: float) -> None:
    """A positive coefficient's half squared distance is log^2/2: its Hessian is one, however near the end."""
    point = POSITIVE.point(np.array([2.0]))
    found = one(POSITIVE, point, np.array([3.0]), 6.0 * np.e * (1.0 - inside))
    assert found.direction[0, 0] ** 2 + found.curvature[0, 0] == pytest.approx(1.0, abs=1e-5)


def test_hessian_of_rows_with_repeated_eigenvalues() -> None:
    """X-bar proportional to the identity plus a rank-one part: the divided differences' limits."""
    rng = np.random.default_rng(1)
    point = LINK.point(bodies.links(rng, 1)[0])
    for eigenvalues in ([1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, -0.7], [1.0, 1.0, -1.0, -1.0], [0.0, 0.0, 1.0, 1.0]):
        vectors = np.linalg.qr(rng.normal(size=(4, 4)))[0]
        bar = (vectors * np.array(eigenvalues)) @ vectors.T
        row = row_of(point, bar)
        check_hessian(LINK, point, row[None], np.array([row @ point.parameters + 0.3]))


def test_weights_sum_the_rows_curvatures() -> None:
    point, rows, targets = neighbourhood(1, ALL, 6)
    weights, normals = np.random.default_rng(1).uniform(0.1, 5.0, size=len(rows)), ALL.whiten(point, rows)
    together = projection.project(ALL, point, normals, targets, weights).curvature
    singly = [one(ALL, point, row, target).curvature for row, target in zip(rows, targets, strict=True)]
    np.testing.assert_allclose(together, np.einsum("n,nij->ij", weights, singly), rtol=0, atol=ROUNDING)
