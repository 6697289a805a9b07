"""The compiled 4x4 eigendecomposition against LAPACK's."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry.eigen4 import jacobi_eigh
from geomid_ros.types import FloatArray

from . import bodies

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


def decompose(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    work, vectors = np.array(matrix), np.full((4, 4), np.nan)
    jacobi_eigh(work, vectors)
    return np.diag(work).copy(), vectors


@pytest.mark.parametrize("name", matrices())
def test_eigenvalues_are_lapacks(name: str) -> None:
    matrix = matrices()[name]
    expected = np.linalg.eigvalsh(matrix)
    np.testing.assert_allclose(
        np.sort(decompose(matrix)[0]), expected, rtol=0, atol=ROUNDING * np.max(np.abs(expected))
    )


@pytest.mark.parametrize("name", matrices())
def test_eigenvectors_are_orthonormal_and_rebuild_the_matrix(name: str) -> None:
    matrix = matrices()[name]
    values, vectors = decompose(matrix)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), rtol=0, atol=ROUNDING)
    rebuilt = (vectors * values) @ vectors.T
    np.testing.assert_allclose(rebuilt, matrix, rtol=0, atol=ROUNDING * np.max(np.abs(matrix)))


def test_the_lower_triangle_is_not_read() -> None:
    matrix = bodies.symmetric(np.random.default_rng(3))
    values, vectors = decompose(np.triu(matrix) + np.tril(np.full((4, 4), np.nan), -1))
    np.testing.assert_allclose((vectors * values) @ vectors.T, matrix, rtol=0, atol=10 * ROUNDING)
