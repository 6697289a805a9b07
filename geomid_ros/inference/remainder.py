"""What a model lacks, as a part of the likelihood: features with Gaussian coefficients that are never fitted.

A channel's rows are ``y = X theta + F u + e`` with noise e of variance s^2 and u ~ N(0, s^2 R), R diagonal and equal
within a block of features; what was found of u on other recordings is taken off y, and R is larger by what that left
unsure. With u integrated out, the products of columns are Schur complements, so that the profile
likelihood ``N log S`` over s stays exact (Kennedy and O'Hagan, "Bayesian calibration of computer models", 2001).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.types import FloatArray, IntArray

USUAL = 0.3**2
"""The usual variance of what a block adds, in units of the noise's."""
_IMPERFECT = 0.05  # of what is named, as a root mean square: in each block so much may be otherwise
_STARTS = (USUAL, 3.0**2)  # there are several minima
_ROUNDS = 20
_SETTLED = 0.1  # of the logarithm of a variance


@dataclass(frozen=True, eq=False)
class Marginal:
    """Columns' ``products (K, K)`` with the features integrated out, which takes their ``whitener (m, m)`` and adds a
    ``cost`` to minus twice the log likelihood."""

    products: FloatArray
    whitener: FloatArray
    cost: float


@dataclass(frozen=True, eq=False)
class Remainder:
    """Products of a channel's features, where a draw of a block with variance 1 has a mean square of 1.

    Attributes:
        squared: products ``(m, m)`` of the features.
        crossed: products ``(m, K)`` of features and columns.
        block: which block each feature belongs to ``(m,)``.
        count: number of rows.
        before: covariance ``(m, m)`` of what other recordings left unsure of the coefficients, in units of the noise's
            variance; None without any.
    """

    squared: FloatArray
    crossed: FloatArray
    block: IntArray
    count: int
    before: FloatArray | None = None

    @property
    def usual(self) -> FloatArray:
        """The usual variance of each block."""
        return np.full(int(np.max(self.block, initial=-1)) + 1, USUAL)

    def marginalised(self, products: FloatArray, variances: FloatArray) -> Marginal:
        """Products ``(K, K)`` of the columns with the features integrated out, for ``variances (blocks,)``."""
        whitener = self.whitener(variances)
        crossed = whitener @ self.crossed
        return Marginal(products - crossed.T @ crossed, whitener, self._cost(whitener, variances))

    def whitener(self, variances: FloatArray) -> FloatArray:
        """The T ``(m, m)`` of which ``T'T`` is the coefficients' covariance after the data, in units of the noise's
        variance."""
        return definite.whitener(self.squared + self._precision(variances))

    def _precision(self, variances: FloatArray) -> FloatArray:
        """Of the coefficients before the data ``(m, m)``."""
        own = variances[self.block]
        return np.diag(1.0 / own) if self.before is None else definite.inverse(self.before + np.diag(own))

    def root(self, variances: FloatArray) -> FloatArray:
        """A root ``(m, m)`` of the coefficients' covariance before the data."""
        own = variances[self.block]
        return np.asarray(np.diag(own**0.5) if self.before is None else np.linalg.cholesky(self.before + np.diag(own)))

    def _cost(self, whitener: FloatArray, variances: FloatArray) -> float:
        """What the features add to minus twice the log likelihood: ``log det(I + R^1/2 F'F R^1/2)``, and the
        inverse-gamma prior of the variances where these are estimated."""
        volume = 2.0 * float(np.sum(np.log(np.diag(self.root(variances)) / np.abs(np.diag(whitener)))))
        if self.before is not None:
            return volume
        relative = variances / USUAL
        return volume + float(np.sum(np.log(relative) + 1.0 / relative - 1.0))

    def settled(self, vector: FloatArray, square: float, named: float, near: FloatArray | None = None) -> FloatArray:
        """The variances ``(blocks,)`` that are most likely for a residual ``vector`` of the columns ``(K,)`` with this
        sum of squares, by MacKay's fixed point from several starts, or from those ``near`` it ``(blocks,)``.

        Beside other recordings what is lacking does not change but as much as usual, and by a share of what is
        ``named``, a mean square in units of the noise's variance: no name acts exactly as its columns say.
        """
        if self.before is not None:
            return self.usual + _IMPERFECT**2 * named
        if not len(self.block) or not square > 0.0:
            return self.usual
        residual = self.crossed @ vector
        starts = self._starts if near is None else [(near, self.whitener(near))]
        found = [self._from(*start, residual, square) for start in starts]
        return min(found, key=lambda own: own[0])[1]

    @cached_property
    def _starts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Variances to begin with, and their whiteners."""
        starts = [start * np.ones(len(self.usual)) for start in _STARTS]
        return [(variances, self.whitener(variances)) for variances in starts]

    def _from(
        self, variances: FloatArray, whitener: FloatArray, residual: FloatArray, square: float
    ) -> tuple[float, FloatArray]:
        sizes = np.bincount(self.block).astype(np.float64)
        for _ in range(_ROUNDS):
            before, white = variances, whitener @ residual
            noise = max(square - float(white @ white), 1e-9 * square) / self.count
            told = sizes - np.bincount(self.block, np.sum(whitener**2, axis=0)) / variances
            variances = (np.bincount(self.block, (white @ whitener) ** 2) / noise + USUAL) / (told + 1.0)
            whitener = self.whitener(variances)
            if np.all(np.abs(np.log(variances / before)) < _SETTLED):
                break
        left = max(square - float(np.sum((whitener @ residual) ** 2)), 1e-9 * square)
        return self.count * float(np.log(left)) + self._cost(whitener, variances), variances
