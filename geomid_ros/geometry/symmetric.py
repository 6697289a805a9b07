"""Coordinates of symmetric 4x4 matrices: an isometry S(4) -> R^10.

The order is the diagonal, then the upper triangle row by row, off-diagonal entries times sqrt(2), so that the
Frobenius inner product of matrices is the dot product of coordinates.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray

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


# Entry (a, b) of a congruence: (i, j) = (ROWS, COLUMNS)[a] and (k, l) = (ROWS, COLUMNS)[b].
_IK, _JL = 4 * ROWS[:, None] + ROWS, 4 * COLUMNS[:, None] + COLUMNS
_IL, _JK = 4 * ROWS[:, None] + COLUMNS, 4 * COLUMNS[:, None] + ROWS
_CONGRUENCE_SCALE = 0.5 * _SCALE[:, None] * _SCALE


def congruence(factor: FloatArray) -> FloatArray:
    """Return the matrices ``(..., 10, 10)`` that map the coordinates of X to those of ``G X G^T``, for G ``(..., 4,
    4)``: the symmetric Kronecker product of G with itself, which is orthogonal or symmetric if G is."""
    entries = factor.reshape(*factor.shape[:-2], 16)
    products = entries.take(_IK, -1) * entries.take(_JL, -1) + entries.take(_IL, -1) * entries.take(_JK, -1)
    return np.asarray(_CONGRUENCE_SCALE * products)
