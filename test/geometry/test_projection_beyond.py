"""Where Proposition 2 has no root, and the end of the interval where it is lost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import lambertw

from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.geometry.projection import NO_ROOT_HIGH, NO_ROOT_LOW, ROOT

from . import bodies
from .planes import (
    ALL,
    LINK,
    MASS,
    SHAPES,
    beyond,
    end_of_the_interval,
    norms,
    one,
    problem,
    project,
    spectrum,
)

pytestmark = pytest.mark.usefixtures("either")

EPSILON = float(np.finfo(float).eps)
ON_THE_PLANE = 1e-10  # residual over the row's dual norm
ROUNDING = 1e-9


@SHAPES
def test_the_distance_is_the_maximum_of_the_dual_function(manifold: ParameterManifold) -> None:
    """Independent of roots: the dual at many multipliers never exceeds the half squared distance, inside and beyond."""
    point, rows, targets = problem(1, manifold, 12, 4.0)
    found, normals = project(manifold, point, rows, targets), manifold.whiten(point, rows)
    assert {ROOT, NO_ROOT_LOW} <= set(found.status)
    for k in range(12):
        s, reals = spectrum(manifold, normals[k]), normals[k, manifold.real]
        offset = reals @ (point.reals / manifold.scales) - targets[k]
        low, high = -1.0 / (np.e * s.max()), -1.0 / (np.e * s.min())
        best = -np.inf
        for _ in range(6):
            grid = np.linspace(low, high, 401)
            w = lambertw(grid[:, None] * s * (1.0 - 1e-15)).real
            values = 0.5 * np.sum(w**2, axis=1) + 0.5 * grid**2 * (reals @ reals)
            values += grid * (np.exp(-w) @ s + offset - grid * (reals @ reals))
            top = int(np.argmax(values))
            best = max(best, float(values[top]))
            low, high = grid[max(top - 1, 0)], grid[min(top + 1, 400)]
        assert found.half_squared[k] == pytest.approx(best, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("target", [-1.0, 0.0])
@pytest.mark.parametrize("count", [1, 2, 16])
def test_a_hyperplane_outside_the_manifold_has_no_root(count: int, target: float) -> None:
    """No robot has a negative or no total mass."""
    manifold = ParameterManifold(count, 0, np.zeros(0))
    for seed in range(5):
        point = bodies.point(np.random.default_rng(seed), manifold)
        found = one(manifold, point, np.tile(MASS, count), target)
        assert found.status[0] == NO_ROOT_HIGH
        mirrored = one(manifold, point, -np.tile(MASS, count), -target)
        assert mirrored.status[0] == NO_ROOT_LOW
        assert np.all(np.isfinite([found.half_squared[0], mirrored.half_squared[0]]))


def test_a_hyperplane_outside_the_manifold_costs_the_same_whatever_the_rounding() -> None:
    """The row's zero eigenvalues arrive as +-1e-17; that noise must not decide between no cost and 1e16."""
    costs = []
    for seed in range(10):
        point = bodies.point(np.random.default_rng(seed), LINK)
        costs.append(one(LINK, point, MASS / point.parameters[0], -1.0).half_squared[0])
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)


def test_a_real_takes_up_what_no_body_can() -> None:
    """A negative total with an offset in the row is possible: the offset absorbs it."""
    manifold = ParameterManifold(1, 1, np.array([0.5]))
    point = bodies.point(np.random.default_rng(0), manifold)
    row = np.concatenate([MASS, [1.0, 1.0]])
    found = one(manifold, point, row, -3.0)
    landed = manifold.exp(point, found.tangent[0])
    assert found.status[0] == ROOT
    assert row @ landed.parameters == pytest.approx(-3.0, rel=ROUNDING)
    assert landed.reals[0] < -3.0


@pytest.mark.parametrize("side", [NO_ROOT_LOW, NO_ROOT_HIGH])
@SHAPES
def test_up_to_the_end_of_the_interval_the_hyperplane_is_reached(manifold: ParameterManifold, side: int) -> None:
    """Exactly there the root is lost, and value and gradient are continuous.

    The slope of (21) is infinite at the end: a rounded multiplier misses by eps over the gap, and by no more.
    """
    point, rows, _ = problem(1, manifold, 4, 0.0)
    for row, norm in zip(rows, norms(manifold, point, rows), strict=True):
        end = end_of_the_interval(manifold, point, row, side)
        outward = norm if side == NO_ROOT_LOW else -norm
        assert one(manifold, point, row, end + 1e-6 * outward).status[0] == side
        for gap in 10.0 ** np.arange(-7.0, 0.0):
            target = end - gap * outward
            found = one(manifold, point, row, target)
            assert found.status[0] == ROOT
            landed = manifold.exp(point, found.tangent[0]).parameters
            assert abs(row @ landed - target) <= (ON_THE_PLANE + 20 * EPSILON / gap) * norm
        at_end = one(manifold, point, row, end)
        for found in (one(manifold, point, row, end + shift) for shift in (-1e-9 * norm, 1e-9 * norm)):
            assert found.half_squared[0] == pytest.approx(at_end.half_squared[0], rel=1e-7)
            np.testing.assert_allclose(found.tangent, at_end.tangent, rtol=0, atol=1e-3)  # a square root in b


@pytest.mark.parametrize("side", [NO_ROOT_LOW, NO_ROOT_HIGH])
def test_the_continuation_is_linear_in_the_target_and_grows(side: int) -> None:
    point, rows, targets = beyond(1, ALL, side)
    lengths = norms(ALL, point, rows)
    step = lengths if side == NO_ROOT_LOW else -lengths
    near, middle, far = (project(ALL, point, rows, targets + k * step).half_squared for k in (0, 1, 2))
    np.testing.assert_allclose(far - middle, middle - near, rtol=1e-8)
    assert np.all(middle > near)


def test_every_row_far_or_near_has_finite_answers() -> None:
    for reach in (0.0, 1e-12, 1e-6, 1.0, 1e3, 1e9):
        found = project(ALL, *problem(1, ALL, 30, reach))
        for name in ("half_squared", "tangent", "direction", "curvature"):
            assert np.all(np.isfinite(getattr(found, name)))
        assert np.all(found.half_squared >= 0.0)
