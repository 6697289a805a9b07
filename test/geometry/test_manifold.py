"""The product of links, positive coefficients and reals."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

from . import bodies

ROUNDING = 1e-9  # relative; links' condition numbers reach 1e5
FINITE_DIFFERENCE = 1e-6
SHAPES = pytest.mark.parametrize(
    "manifold",
    [
        ParameterManifold(3, 2, np.array([0.1, 20.0])),
        ParameterManifold(1, 0, np.zeros(0)),
        ParameterManifold(0, 3, np.ones(1)),
        ParameterManifold(0, 0, np.array([5.0])),
        ParameterManifold(2, 0, np.array([1e-3])),
    ],
    ids=["all", "link", "coefficients", "real", "links and real"],
)
ALL = ParameterManifold(3, 2, np.array([0.1, 20.0]))
LINK = ParameterManifold(1, 0, np.zeros(0))


def finite_difference_jacobian(manifold: ParameterManifold, base: Point) -> FloatArray:
    """Derivative ``(D, D)`` of the parameters by the tangent coordinates."""
    h = 1e-5
    steps = h * np.eye(manifold.dimension)
    columns = [manifold.exp(base, step).parameters - manifold.exp(base, -step).parameters for step in steps]
    return np.array(columns).T / (2.0 * h)


@SHAPES
def test_log_after_exp_is_the_tangent_and_a_point_is_that_of_its_parameters(manifold: ParameterManifold) -> None:
    rng = np.random.default_rng(1)
    base, tangent = bodies.point(rng, manifold), rng.normal(size=manifold.dimension)
    np.testing.assert_allclose(manifold.point(base.parameters).parameters, base.parameters, rtol=ROUNDING, atol=1e-15)
    np.testing.assert_allclose(manifold.log(base, manifold.exp(base, tangent)), tangent, rtol=0, atol=10 * ROUNDING)


def test_exp_log_and_geodesics_of_a_link_are_pyriemanns() -> None:
    """Tangent coordinates are those of ``P^-1/2 V P^-1/2``."""
    tangent_space = pytest.importorskip("pyriemann.utils.tangentspace")
    geodesic = pytest.importorskip("pyriemann.utils.geodesic")
    a, b = bodies.spd(np.random.default_rng(1), 2)
    base, other = Point(a[None], np.zeros(0), np.zeros(0)), Point(b[None], np.zeros(0), np.zeros(0))
    tangent = LINK.log(base, other)
    velocity = spd.congruence(base.root[0], spd.to_matrix(tangent))
    size = np.max(np.abs(b))
    np.testing.assert_allclose(velocity, tangent_space.log_map_riemann(b, a, C12=True), rtol=0, atol=ROUNDING * size)
    for share in (0.3, 1.0):
        reached = LINK.exp(base, share * tangent).pseudo_inertias[0]
        np.testing.assert_allclose(reached, geodesic.geodesic_riemann(a, b, alpha=share), rtol=0, atol=ROUNDING * size)


@SHAPES
def test_jacobian_is_the_derivative_of_the_parameters(manifold: ParameterManifold) -> None:
    base = bodies.point(np.random.default_rng(1), manifold)
    blocks, diagonal = manifold.jacobian(base)
    expected = finite_difference_jacobian(manifold, base)
    jacobian = np.zeros_like(expected)
    for k, block in enumerate(blocks):
        jacobian[manifold.link(k), manifold.link(k)] = block
    rest = np.arange(manifold.inertial.stop, manifold.dimension)
    jacobian[rest, rest] = diagonal
    size = np.maximum(np.max(np.abs(expected), axis=1, keepdims=True), 1e-12)
    np.testing.assert_allclose(jacobian / size, expected / size, rtol=0, atol=FINITE_DIFFERENCE)


@SHAPES
def test_hessian_of_the_half_squared_distance_by_finite_differences(manifold: ParameterManifold) -> None:
    rng = np.random.default_rng(1)
    base = bodies.point(rng, manifold)
    other = bodies.near(rng, manifold, base, 2.0)
    hessian = np.zeros((manifold.dimension,) * 2)
    manifold.add_blocks(
        hessian, manifold.log_and_hessian(base, other)[1], np.ones(manifold.positives + len(manifold.scales))
    )
    h = 1e-3
    for v in rng.normal(size=(3, manifold.dimension)):
        before, here, after = (0.5 * manifold.distance(manifold.exp(base, t * v), other) ** 2 for t in (-h, 0.0, h))
        assert v @ hessian @ v == pytest.approx((before - 2.0 * here + after) / h**2, rel=1e-4)


def test_points_are_read_only_copies() -> None:
    reals = np.zeros(2)
    point = Point(np.eye(4)[None], np.ones(2), reals)
    reals[0] = 1.0
    assert point.reals[0] == 0.0
    for name in ("pseudo_inertias", "positives", "reals", "root", "inverse_root", "parameters"):
        array = getattr(point, name)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@SHAPES
def test_the_derivative_of_the_exponential_is_that_of_finite_differences(manifold: ParameterManifold) -> None:
    rng = np.random.default_rng(1)
    base, tangent = bodies.point(rng, manifold), 0.5 * rng.normal(size=manifold.dimension)
    steps = 1e-5 * np.eye(manifold.dimension)
    ends = [[manifold.exp(base, tangent + sign * step).parameters for step in steps] for sign in (1.0, -1.0)]
    numeric = (np.array(ends[0]) - np.array(ends[1])).T / 2e-5
    derivative = manifold.by_blocks(np.eye(manifold.dimension), *manifold.exp_jacobian(base, tangent))
    np.testing.assert_allclose(derivative, numeric, rtol=1e-4, atol=FINITE_DIFFERENCE * np.max(np.abs(numeric)))


@pytest.mark.parametrize("share", [0.3, 0.499, 0.501, 0.8, 1.5, 20.0])
def test_a_straight_line_bends_where_it_would_leave_the_cone(share: float) -> None:
    """Of three links one shrinks by ``share`` in one direction; another takes a short step, the last one grows."""
    rng = np.random.default_rng(1)
    base = bodies.point(rng, ALL)
    turned, _ = np.linalg.qr(rng.normal(size=(3, 4, 4)))
    values = np.array([[-share, 0.2, 0.1, 0.4], [-0.2, 0.1, 0.1, -0.1], [3.0, 1.0, 0.5, 0.1]])
    changes = turned @ (values[:, :, None] * turned.swapaxes(1, 2))
    tangent = np.concatenate([spd.to_vector(changes).ravel(), [-share, 0.3], [-3.0, 0.5]])
    end = ALL.straight(base, tangent)
    left = 1.0 - share if share < 0.5 else max(0.5 * np.exp(1.0 - 2.0 * share), 0.05)
    factors = 1.0 + values
    factors[0, 0] = left
    expected = base.root @ (turned @ (factors[:, :, None] * turned.swapaxes(1, 2))) @ base.root
    np.testing.assert_allclose(end.pseudo_inertias, expected, rtol=0.0, atol=ROUNDING * np.max(np.abs(expected)))
    np.testing.assert_allclose(end.positives, base.positives * [left, 1.3])
    np.testing.assert_allclose(end.reals, base.reals + ALL.scales * [-3.0, 0.5])
