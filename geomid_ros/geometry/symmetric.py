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


def to_vector(matrix: FloatArray) -> FloatArray:
    """Coordinates ``(..., 10)`` of symmetric matrices ``(..., 4, 4)``."""
    return matrix[..., ROWS, COLUMNS] * _SCALE


def to_matrix(vector: FloatArray) -> FloatArray:
    """Symmetric matrices ``(..., 4, 4)`` of coordinates ``(..., 10)``."""
    matrix = np.empty((*vector.shape[:-1], 4, 4))
    entries = vector / _SCALE
    matrix[..., ROWS, COLUMNS] = entries
    matrix[..., COLUMNS, ROWS] = entries
    return matrix
