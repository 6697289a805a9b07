"""The principal branch of Lambert's W over its whole domain."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from geomid_ros.geometry import compiled
from geomid_ros.geometry.projection import coefficients, lambert_w
from geomid_ros.types import FloatArray

from . import bodies

EPSILON = float(np.finfo(float).eps)
BRANCH_POINT = -1.0 / math.e


def exact(z: float) -> float:
    """W of the double ``z`` by bisection in fifty digits: slow, and free of floating point."""
    with localcontext() as context:
        context.prec = 50
        target, low, high = Decimal(z), Decimal(-1), Decimal(2) + (Decimal(z) + 2).ln()
        for _ in range(160):
            middle = (low + high) / 2
            low, high = (middle, high) if middle * middle.exp() < target else (low, middle)
        return float(low)


def test_it_is_exact_from_the_branch_point_on() -> None:
    for z in [*(BRANCH_POINT + 10.0 ** np.arange(-16.0, -0.4, 1.0)), *10.0 ** np.arange(-300.0, 300.0, 60.7)]:
        w = exact(z)
        assert abs(lambert_w(np.array(z)) - w) <= 4 * EPSILON / (1.0 + w) + 4 * EPSILON * abs(w)


def test_the_polynomial_is_exact_over_its_range() -> None:
    """As far as the rounding of the argument lets W be known."""
    for v in np.linspace(-1.0 + 1e-6, 1.0, 41):
        w = exact(((1.0 + v) ** 2 - 1.0) / math.e)
        assert abs(polyval(v, coefficients()) * v - w) <= 4 * EPSILON / (1.0 + w) + 4 * EPSILON


@pytest.mark.parametrize("z", [BRANCH_POINT - 1e-12, -0.5, -1e300, -math.inf])
def test_it_is_minus_one_below_its_domain(z: float) -> None:
    assert lambert_w(np.array(z)) == -1.0


LANES = 8
ROUNDING = 1e-14  # relative to the largest eigenvalue


def matrices() -> dict[str, FloatArray]:
    """Symmetric matrices, the awkward ones by name."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=4)
    q = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    scales = np.diag(10.0 ** np.array([-6.0, -2.0, 2.0, 6.0]))
    named = {
        "zero": np.zeros((4, 4)),
        "identity": np.eye(4),
        "diagonal": np.diag([3.0, -1.0, 2.0, -7.0]),
        "ones": np.ones((4, 4)),
        "rank one": np.outer(u, u),
        "two pairs": (q * [2.0, 2.0, -1.0, -1.0]) @ q.T,
        "three equal": (q * [5.0, 5.0, 5.0, 1.0]) @ q.T,
        "nearly equal": (q * [1.0, 1.0 + 1e-9, 1.0 - 1e-12, 1.0]) @ q.T,
        "one coupling": np.eye(4) + 1e-9 * np.eye(4)[:, ::-1],
        "badly scaled": scales @ bodies.spd(rng) @ scales,
        "tiny": 1e-120 * bodies.symmetric(rng),
        "huge": 1e120 * bodies.symmetric(rng),
    }
    return named | {f"random {k}": bodies.symmetric(rng) for k in range(20)}


def decompose(matrix: FloatArray, lane: int) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues ``(4,)`` and vectors ``(4, 4)`` of one matrix among others of all sizes."""
    if compiled.native is None:
        pytest.skip("built without a compiler")
    rng = np.random.default_rng(1)
    stack = np.array([10.0**k * bodies.symmetric(rng) for k in range(LANES)])
    stack[lane] = matrix
    values, vectors = np.full((LANES, 4), np.nan), np.full((LANES, 4, 4), np.nan)
    compiled.native.eigenvectors(stack, values, vectors)
    return values[lane], vectors[lane]


@pytest.mark.parametrize("name", matrices())
def test_matrices_are_rebuilt_of_orthonormal_eigenvectors_and_lapacks_eigenvalues(name: str) -> None:
    """In every lane the same."""
    matrix = matrices()[name]
    (values, vectors), *others = (decompose(matrix, lane) for lane in range(LANES))
    for other in others:
        np.testing.assert_array_equal(other[0], values)
        np.testing.assert_array_equal(other[1], vectors)
    expected, size = np.linalg.eigvalsh(matrix), np.max(np.abs(matrix))
    np.testing.assert_allclose(np.sort(values), expected, rtol=0, atol=ROUNDING * np.max(np.abs(expected)))
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose((vectors * values) @ vectors.T, matrix, rtol=0, atol=ROUNDING * size)
