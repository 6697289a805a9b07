"""Symmetric positive definite matrices: by Cholesky's decomposition, in half of the time of general methods.

The compiled one leaves out what is zero, and stays zero: limbs know nothing of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.geometry import compiled
from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Packed:
    """A symmetric matrix ``(size, size)`` in little memory: the ``values`` of its lower triangle that are not zero, and
    their ``places``."""

    size: int
    places: IntArray
    values: FloatArray

    @staticmethod
    def of(matrix: FloatArray) -> Packed:
        """Of a whole matrix."""
        lower = np.tril(matrix).ravel()
        places = np.flatnonzero(lower)
        return Packed(len(matrix), places, lower[places])

    @property
    def whole(self) -> FloatArray:
        """The whole matrix."""
        found = np.zeros((self.size, self.size))
        found.flat[self.places] = self.values
        return found + np.tril(found, -1).T


@cache
def _lapack() -> ModuleType:
    from scipy.linalg import lapack  # noqa: PLC0415 what solves nothing need not load it

    return lapack  # type: ignore[no-any-return]


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The x with ``matrix (n, n) x = right (n, ...)``. Raises LinAlgError for one that is not positive definite."""
    if compiled.native is not None:
        if right.ndim == 1:
            return damped_step(matrix, -right, 0.0)[0]
        if (root := _native_roots(matrix, len(matrix))) is None:
            raise LinAlgError("not positive definite")
        return np.asarray(root @ (root.T @ right))
    _, x, failed = _lapack().dposv(matrix, right, lower=1)
    if failed:
        raise LinAlgError("not positive definite")
    return np.asarray(x)


def damped_step(matrix: FloatArray, gradient: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """The x of ``(matrix + damping 1) x = -gradient (n,)``, and ``x (matrix + damping 1)^-1 x``. Raises LinAlgError
    where that matrix is not positive definite."""
    if compiled.native is not None:
        x = np.empty(len(matrix))
        bend = compiled.native.damped(np.ascontiguousarray(matrix), np.ascontiguousarray(gradient), damping, x)
        if not bend >= 0.0:
            raise LinAlgError("not positive definite")
        return x, float(bend)
    factor, x, failed = _lapack().dposv(matrix + damping * np.eye(len(matrix)), -gradient, lower=1)
    if failed:
        raise LinAlgError("not positive definite")
    y, _ = _lapack().dpotrs(factor, x, lower=1)
    return np.asarray(x), float(x @ y)


def solved_anyway(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The x with ``matrix (n, n) x = right (n,)``; the shortest of those that come nearest where rounding leaves the
    matrix not quite positive definite."""
    try:
        return solved(matrix, right)
    except LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def whitener(matrix: FloatArray) -> FloatArray:
    """A triangular T ``(n, n)`` with ``T matrix T' = 1``, so that ``T'T`` is the inverse; where rounding leaves the
    matrix not quite positive definite, that of the nearest one which is."""
    return np.asarray(roots(matrix, len(matrix)).T)


def roots(matrix: FloatArray, count: int) -> FloatArray:
    """R ``(count, n)`` of which ``R R'`` is the first block of the inverse of ``matrix (n, n)``, or of the nearest one
    that is positive definite."""
    if not len(matrix):
        return matrix
    if (found := _native_roots(matrix, count)) is not None:
        return found
    factor, failed = _lapack().dpotrf(matrix, lower=1, clean=1)
    if not failed:
        return np.asarray(_lapack().dtrtri(factor, lower=1)[0][:, :count].T)
    values, vectors = np.linalg.eigh(matrix)
    values = np.maximum(values, np.finfo(np.float64).eps * values[-1])
    nearest = np.asarray(np.linalg.qr((vectors / np.sqrt(values)).T, mode="r"))
    return np.asarray(nearest[:, :count].T)


def _native_roots(matrix: FloatArray, count: int) -> FloatArray | None:
    """The same by the compiled decomposition; None without it, and for a matrix that is not positive definite."""
    found = np.empty((count, len(matrix)))
    if compiled.native is not None and compiled.native.roots(matrix.copy(), found)[0]:
        return found
    return None


def log_determinant(matrix: FloatArray) -> float:
    """The logarithm of the determinant of ``matrix (n, n)``; of its size where rounding leaves it not quite positive
    definite."""
    if compiled.native is not None:
        definite, found = compiled.native.roots(matrix.copy(), np.empty((0, len(matrix))))
        if definite:
            return float(found)
    return float(np.linalg.slogdet(matrix)[1])


def variances(matrix: FloatArray, count: int) -> FloatArray:
    """The first elements of the diagonal of the inverse of ``matrix (n, n)``, ``(count,)``."""
    return np.asarray(np.sum(roots(matrix, count) ** 2, axis=1))


def inverse(matrix: FloatArray) -> FloatArray:
    """The inverse of ``matrix (n, n)``; by a general method where rounding leaves it not quite positive definite."""
    if (root := _native_roots(matrix, len(matrix))) is not None:
        return np.asarray(root @ root.T)
    factor, failed = _lapack().dpotrf(matrix, lower=1, clean=1)
    if failed:
        return np.asarray(np.linalg.inv(matrix))
    half, _ = _lapack().dpotri(factor, lower=1)
    whole = half + half.T
    np.fill_diagonal(whole, np.diag(half))
    return np.asarray(whole)
