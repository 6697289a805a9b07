"""What a model lacks, as a part of the likelihood: features with Gaussian coefficients that are never fitted.

A channel's rows are ``y = X theta + F u + e`` with noise e of variance s^2 and u ~ N(0, s^2 R), R diagonal and equal
within a block of features. With u integrated out, the products of columns are Schur complements, so that the profile
likelihood ``N log S`` over s stays exact (Kennedy and O'Hagan, "Bayesian calibration of computer models", 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.types import FloatArray, IntArray

USUAL = 0.3**2
"""The usual variance of what a block adds, in units of the noise's."""
_STARTS = (USUAL, 3.0**2)  # there are several minima
_ROUNDS = 20
_SETTLED = 0.1  # of the logarithm of a variance


@dataclass(frozen=True, eq=False)
class Remainder:
    """Products of a channel's features, where a draw of a block with variance 1 has a mean square of 1.

    Attributes:
        squared: products ``(m, m)`` of the features.
        crossed: products ``(m, K)`` of features and columns.
        block: which block each feature belongs to ``(m,)``.
        count: number of rows.
    """

    squared: FloatArray
    crossed: FloatArray
    block: IntArray
    count: int

    @property
    def usual(self) -> FloatArray:
        """The usual variance of each block."""
        return np.full(int(np.max(self.block, initial=-1)) + 1, USUAL)

    def marginalised(self, products: FloatArray, variances: FloatArray) -> FloatArray:
        """Products ``(K, K)`` of the columns with the features integrated out, for ``variances (blocks,)``."""
        if not len(self.block):
            return products
        solved = self.inverse(variances) @ self.crossed
        return np.asarray(products - self.crossed.T @ solved)

    def inverse(self, variances: FloatArray) -> FloatArray:
        """Covariance ``(m, m)`` of the coefficients after the data, in units of the noise's variance."""
        return definite.inverse(self.squared + np.diag(1.0 / variances[self.block]))

    def cost(self, variances: FloatArray) -> float:
        """What the features add to minus twice the log likelihood: ``log det(I + R^1/2 F'F R^1/2)`` and the
        inverse-gamma prior of the variances."""
        if not len(self.block):
            return 0.0
        root = np.sqrt(variances[self.block])
        _, volume = np.linalg.slogdet(np.eye(len(root)) + root[:, None] * self.squared * root)
        relative = variances / USUAL
        return float(volume + np.sum(np.log(relative) + 1.0 / relative - 1.0))

    def settled(self, vector: FloatArray, square: float) -> FloatArray:
        """The variances ``(blocks,)`` that are most likely for a residual ``vector`` of the columns ``(K,)`` with this
        sum of squares, by MacKay's fixed point from several starts."""
        if not len(self.block) or not square > 0.0:
            return self.usual
        residual = self.crossed @ vector
        found = [self._from(start * np.ones(len(self.usual)), residual, square) for start in _STARTS]
        return min(found, key=lambda own: own[0])[1]

    def _from(self, variances: FloatArray, residual: FloatArray, square: float) -> tuple[float, FloatArray]:
        sizes, inverse = np.bincount(self.block).astype(np.float64), self.inverse(variances)
        for _ in range(_ROUNDS):
            before, mean = variances, inverse @ residual
            noise = max(square - float(mean @ residual), 1e-9 * square) / self.count
            told = sizes - np.bincount(self.block, np.diag(inverse)) / variances
            variances = (np.bincount(self.block, mean**2) / noise + USUAL) / (told + 1.0)
            inverse = self.inverse(variances)
            if np.all(np.abs(np.log(variances / before)) < _SETTLED):
                break
        left = max(square - float(residual @ inverse @ residual), 1e-9 * square)
        return self.count * float(np.log(left)) + self.cost(variances), variances
