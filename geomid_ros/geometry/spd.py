"""Symmetric positive definite matrices, P(n): coordinates of their tangent space, geometry, and linear algebra.

Every function of the geometry works on stacks: ``(..., n, n)``.

The paper prints the metric (5) with a factor 1/2 and the distance (9) without it, so that the norm of the
logarithm (8) would be the distance over sqrt(2). Here the metric is ``tr(P^-1 X P^-1 Y)``, without the factor. So
the distance is the printed one and equals the norm of the logarithm. Minimisers do not depend on this choice.

The order of the coordinates of symmetric 4x4 matrices, an isometry S(4) -> R^10, is the diagonal, then the upper
triangle row by row, off-diagonal entries times sqrt(2), so that the Frobenius inner product of matrices is the dot
product of coordinates.

The linear algebra is by Cholesky decomposition, in half of the time of general methods. The compiled version skips
entries that are zero and stay zero, such as those between limbs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.geometry import compiled
from geomid_ros.types import BoolArray, FloatArray, IntArray

SIZE = 10
ROWS = np.array([0, 1, 2, 3, 0, 0, 0, 1, 1, 2])
COLUMNS = np.array([0, 1, 2, 3, 1, 2, 3, 2, 3, 3])
_SCALE = np.where(ROWS == COLUMNS, 1.0, np.sqrt(2.0))
_FLAT = 4 * ROWS + COLUMNS


def to_vector(matrix: FloatArray) -> FloatArray:
    """Return coordinates ``(..., 10)`` of symmetric matrices ``(..., 4, 4)``."""
    return np.asarray(matrix.reshape(*matrix.shape[:-2], 16).take(_FLAT, -1) * _SCALE)


def to_matrix(vector: FloatArray) -> FloatArray:
    """Return symmetric matrices ``(..., 4, 4)`` of coordinates ``(..., 10)``."""
    matrix = np.empty((*vector.shape[:-1], 4, 4))
    entries = vector / _SCALE
    matrix[..., ROWS, COLUMNS] = entries
    matrix[..., COLUMNS, ROWS] = entries
    return matrix


UNITS = to_matrix(np.eye(SIZE))
"""Symmetric matrices ``(10, 4, 4)`` of the unit vectors."""
# Entry (a, b) of a congruence: (i, j) = (ROWS, COLUMNS)[a] and (k, l) = (ROWS, COLUMNS)[b].
_IK, _JL = 4 * ROWS[:, None] + ROWS, 4 * COLUMNS[:, None] + COLUMNS
_IL, _JK = 4 * ROWS[:, None] + COLUMNS, 4 * COLUMNS[:, None] + ROWS
_CONGRUENCE_SCALE = 0.5 * _SCALE[:, None] * _SCALE


def congruence_matrix(factor: FloatArray) -> FloatArray:
    """Return the matrices ``(..., 10, 10)`` that map the coordinates of X to those of ``G X G^T``, for G ``(..., 4,
    4)``: the symmetric Kronecker product of G with itself, which is orthogonal or symmetric if G is."""
    entries = factor.reshape(*factor.shape[:-2], 16)
    products = entries.take(_IK, -1) * entries.take(_JL, -1) + entries.take(_IL, -1) * entries.take(_JK, -1)
    return np.asarray(_CONGRUENCE_SCALE * products)


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


def transport_factor(base: FloatArray, point: FloatArray) -> FloatArray:
    """Return E ``(..., n, n)`` with ``E base E^T = point``: ``E X E^T`` is X, transported parallel along the geodesic
    between them."""
    values, vectors = spectrum(base)
    root, inverse = (composed(power, vectors) for power in (np.sqrt(values), 1.0 / np.sqrt(values)))
    values, vectors = spectrum(congruence(inverse, point))
    return np.asarray(root @ composed(np.sqrt(values), vectors) @ inverse)


def spectrum(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues ``(..., n)``, ascending, and eigenvectors of positive definite matrices ``(..., n, n)``.

    An eigenvalue that is lost in the rounding of the largest counts as that rounding, so that a link which data made
    thin beyond double precision has a root and finite distances.
    """
    values, vectors = np.linalg.eigh(matrix)
    return np.maximum(values, np.finfo(float).eps * values[..., -1:]), vectors


def relative_eigenvalues(base: FloatArray, point: FloatArray) -> FloatArray:
    """Eigenvalues of ``base^-1/2 point base^-1/2`` in ascending order, shape ``(..., n)``."""
    values, vectors = spectrum(base)
    return spectrum(congruence(composed(1.0 / np.sqrt(values), vectors), point))[0]


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
    half = 0.5 * (values[..., ROWS] - values[..., COLUMNS])
    safe = np.where(np.abs(half) < 1e-6, 1.0, half)
    entries = np.where(np.abs(half) < 1e-6, 1.0, safe / np.tanh(safe))
    basis = congruence_matrix(np.swapaxes(vectors, -1, -2))
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


@dataclass(frozen=True, eq=False)
class Packed:
    """Sparse storage of a symmetric matrix ``(size, size)``: the nonzero ``values`` of its lower triangle, and their
    flat indices ``places``."""

    size: int
    places: IntArray
    values: FloatArray

    @staticmethod
    def of(matrix: FloatArray) -> Packed:
        """Pack a full matrix."""
        lower = np.tril(matrix).ravel()
        places = np.flatnonzero(lower)
        return Packed(len(matrix), places, lower[places])

    @property
    def full(self) -> FloatArray:
        """Full matrix ``(size, size)``."""
        lower = np.zeros((self.size, self.size))
        lower.flat[self.places] = self.values
        return lower + np.tril(lower, -1).T


def damped_step(matrix: FloatArray, gradient: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """Solve ``(matrix + damping 1) x = -gradient (n,)``; return x and ``x (matrix + damping 1)^-1 x``. Raises
    LinAlgError if that matrix is not positive definite."""
    if compiled.native is not None:
        x = np.empty(len(matrix))
        bend = compiled.native.damped(np.ascontiguousarray(matrix), np.ascontiguousarray(gradient), damping, x)
        if not bend >= 0.0:
            raise LinAlgError("not positive definite")
        return x, float(bend)
    root = _factored(matrix + damping * np.eye(len(matrix)), len(matrix))
    y = root.T @ gradient
    return np.asarray(-root @ y), float(np.sum((root.T @ (root @ y)) ** 2))


def solve_or_least_squares(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve ``matrix (n, n) x = right (n, ...)``; by least squares with the least norm if rounding leaves the matrix
    not quite positive definite."""
    try:
        if right.ndim == 1:
            return damped_step(matrix, -right, 0.0)[0]
        root = _factored(matrix, len(matrix))
        return np.asarray(root @ (root.T @ right))
    except LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def whitener(matrix: FloatArray) -> FloatArray:
    """Return a triangular T ``(n, n)`` with ``T matrix T' = 1``, so ``T'T`` is the inverse. If rounding leaves the
    matrix not quite positive definite, use the nearest one that is."""
    return np.asarray(roots(matrix, len(matrix)).T)


def roots(matrix: FloatArray, count: int) -> FloatArray:
    """Return R ``(count, n)`` with ``R R'`` the first block of the inverse of ``matrix (n, n)``, or of the nearest one
    that is positive definite."""
    try:
        return _factored(matrix, count)
    except LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        values = np.maximum(values, np.finfo(np.float64).eps * values[-1])
        nearest = np.asarray(np.linalg.qr((vectors / np.sqrt(values)).T, mode="r"))
        return np.asarray(nearest[:, :count].T)


def _factored(matrix: FloatArray, count: int) -> FloatArray:
    """Compute :func:`roots`. Raises LinAlgError if the matrix is not positive definite."""
    if compiled.native is None:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(matrix))[:, :count].T)
    root = np.empty((count, len(matrix)))
    if not compiled.native.roots(np.array(matrix, dtype=np.float64, order="C"), root)[0]:
        raise LinAlgError("not positive definite")
    return root


def log_determinant(matrix: FloatArray) -> float:
    """Return the logarithm of the determinant of ``matrix (n, n)``; of its absolute value if rounding leaves the matrix
    not quite positive definite."""
    if compiled.native is not None:
        definite, logarithm = compiled.native.roots(matrix.copy(), np.empty((0, len(matrix))))
        if definite:
            return float(logarithm)
    return float(np.linalg.slogdet(matrix)[1])


def variances(matrix: FloatArray, count: int) -> FloatArray:
    """Return the first ``count`` diagonal elements of the inverse of ``matrix (n, n)``."""
    root = roots(matrix, count)
    return np.asarray(np.einsum("ij,ij->i", root, root))


def inverse(matrix: FloatArray) -> FloatArray:
    """Invert ``matrix (n, n)``; by a general method if rounding leaves it not quite positive definite."""
    try:
        root = _factored(matrix, len(matrix))
    except LinAlgError:
        return np.asarray(np.linalg.inv(matrix))
    return np.asarray(root @ root.T)
