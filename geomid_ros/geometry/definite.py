"""Symmetric positive definite matrices by Cholesky decomposition, in half of the time of general methods.

The compiled version skips entries that are zero and stay zero, such as those between limbs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.geometry import compiled
from geomid_ros.types import FloatArray, IntArray


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
