"""Affine-invariant geometry of symmetric positive definite matrices, P(n).

Every function works on stacks: ``(..., n, n)``.

The paper prints the metric (5) with a factor 1/2 and the distance (9) without it, so that the norm of the
logarithm (8) would be the distance over sqrt(2). Here the metric is ``tr(P^-1 X P^-1 Y)``, without the factor. So
the distance is the printed one and equals the norm of the logarithm. Minimisers do not depend on this choice.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.geometry import symmetric
from geomid_ros.types import BoolArray, FloatArray


def composed(values: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return symmetric matrices ``(..., n, n)`` of eigenvalues ``(..., n)`` and orthonormal eigenvectors."""
    return np.asarray((vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def sym_exp(matrix: FloatArray) -> FloatArray:
    """Return the matrix exponential of symmetric matrices ``(..., n, n)``."""
    values, vectors = np.linalg.eigh(matrix)
    return composed(np.exp(values), vectors)


def congruence(factor: FloatArray, matrix: FloatArray) -> FloatArray:
    """Apply the group action ``G * P = G P G^T`` of GL(n), for stacks."""
    return factor @ matrix @ np.swapaxes(factor, -1, -2)


def relative_eigenvalues(base: FloatArray, point: FloatArray) -> FloatArray:
    """Eigenvalues of ``base^-1/2 point base^-1/2`` in ascending order, shape ``(..., n)``."""
    values, vectors = np.linalg.eigh(base)
    return np.asarray(np.linalg.eigvalsh(congruence(composed(1.0 / np.sqrt(values), vectors), point)))


def distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Geodesic distance (9), ``sqrt(sum log^2 eig(a^-1 b))``, shape ``(...)``."""
    return np.asarray(np.sqrt(np.sum(np.log(relative_eigenvalues(a, b)) ** 2, axis=-1)))


def exp_differences(values: FloatArray) -> FloatArray:
    """Divided differences ``(..., n, n)`` of the exponential at eigenvalues ``(..., n)``: the derivative of the matrix
    exponential multiplies a change by them, entry by entry, in the eigenvectors' basis (Daleckii and Krein 1965)."""
    half = 0.5 * (values[..., :, None] - values[..., None, :])
    middle = 0.5 * (values[..., :, None] + values[..., None, :])
    small = np.abs(half) < 1e-6
    safe = np.where(small, 1.0, half)
    return np.asarray(np.exp(middle) * np.where(small, 1.0, np.sinh(safe) / safe))


def half_squared_distance_hessian(values: FloatArray, vectors: FloatArray) -> FloatArray:
    """Hessian ``(..., 10, 10)`` of ``d(P, P_0)^2/2`` at P along geodesics, of 4x4 matrices, in whitened coordinates.

    ``values (..., 4)`` and ``vectors (..., 4, 4)`` are the eigenvalues and eigenvectors of ``log(P^-1/2 P_0 P^-1/2)``.
    In this basis the Hessian is diagonal with the entries ``x coth x``, x half the difference of two eigenvalues. It
    follows from the derivative of the logarithm in Pennec 2006, "A Riemannian framework for tensor computing". It is
    never below the identity.
    """
    half = 0.5 * (values[..., symmetric.ROWS] - values[..., symmetric.COLUMNS])
    safe = np.where(np.abs(half) < 1e-6, 1.0, half)
    entries = np.where(np.abs(half) < 1e-6, 1.0, safe / np.tanh(safe))
    basis = symmetric.congruence(np.swapaxes(vectors, -1, -2))
    return np.swapaxes(basis, -1, -2) @ (entries[..., None] * basis)


def is_positive_definite(matrices: FloatArray) -> BoolArray:
    """True where symmetric matrices ``(..., n, n)`` are positive definite: all pivots of Gaussian elimination are."""
    remaining = matrices.copy()
    result = np.ones(matrices.shape[:-2], dtype=bool)
    for k in range(matrices.shape[-1]):
        pivots = remaining[..., k, k]
        result &= pivots > 0.0
        column = remaining[..., k + 1 :, k] / np.where(result, pivots, 1.0)[..., None]
        remaining[..., k + 1 :, k + 1 :] -= column[..., :, None] * remaining[..., k, None, k + 1 :]
    return result
