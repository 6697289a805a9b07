"""The remainder of the model in the likelihood: features with Gaussian coefficients, integrated out, never fitted.

A channel's rows are ``y = X theta + F u + e`` with noise e of variance s^2 and u ~ N(0, s^2 R), R diagonal and equal
within a block of features. The mean of u given other recordings is taken off y, its covariance is added to R. With u
integrated out, the products of columns are Schur complements, so that the profile likelihood ``N log S`` over s stays
exact (Kennedy and O'Hagan, "Bayesian calibration of computer models", 2001).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.geometry import spd
from geomid_ros.types import BoolArray, FloatArray, IntArray

DEFAULT_VARIANCE = 0.3**2
"""Default prior variance of a block's contribution, in units of the noise variance."""
_IMPERFECT = 0.05  # fraction of the named effects' RMS by which each block may deviate
_STARTS = (DEFAULT_VARIANCE, 3.0**2)  # there are several minima
_ROUNDS = 20
_SETTLED = 0.1  # change of a log variance


@dataclass(frozen=True, eq=False)
class Marginal:
    """Columns' ``products (K, K)`` with the features integrated out, the ``whitener (m, m)`` of these, and the ``cost``
    that this adds to minus twice the log likelihood."""

    products: FloatArray
    whitener: FloatArray
    cost: float


@dataclass(frozen=True, eq=False)
class Remainder:
    """Products of a channel's features, where a draw of a block with variance 1 has a mean square of 1.

    Attributes:
        squared: products ``(m, m)`` of the features.
        crossed: products ``(m, K)`` of features and columns.
        block: index of each feature's block ``(m,)``.
        count: number of rows.
        prior_covariance: of the coefficients given other recordings ``(m, m)``, in noise variances; None without any.
    """

    squared: FloatArray
    crossed: FloatArray
    block: IntArray
    count: int
    prior_covariance: FloatArray | None = None

    @property
    def default_variances(self) -> FloatArray:
        """Default variance of each block ``(blocks,)``."""
        return np.full(int(np.max(self.block, initial=-1)) + 1, DEFAULT_VARIANCE)

    def marginalised(self, products: FloatArray, variances: FloatArray) -> Marginal:
        """Integrate the features out of the ``products (K, K)`` of the columns, for ``variances (blocks,)``."""
        whitener = self.whitener(variances)
        crossed = whitener @ self.crossed
        return Marginal(products - crossed.T @ crossed, whitener, self._cost(whitener, variances))

    def whitener(self, variances: FloatArray) -> FloatArray:
        """Matrix T ``(m, m)``; ``T'T`` is the posterior covariance of the coefficients, in noise variances."""
        return spd.whitener(self.squared + self._precision(variances))

    def _precision(self, variances: FloatArray) -> FloatArray:
        """Prior precision of the coefficients ``(m, m)``."""
        diagonal = variances[self.block]
        return (
            np.diag(1.0 / diagonal)
            if self.prior_covariance is None
            else spd.inverse(self.prior_covariance + np.diag(diagonal))
        )

    def root(self, variances: FloatArray) -> FloatArray:
        """Root ``(m, m)`` of the prior covariance of the coefficients."""
        diagonal = variances[self.block]
        return np.asarray(
            np.diag(diagonal**0.5)
            if self.prior_covariance is None
            else np.linalg.cholesky(self.prior_covariance + np.diag(diagonal))
        )

    def _cost(self, whitener: FloatArray, variances: FloatArray) -> float:
        """Addition of the features to minus twice the log likelihood: ``log det(I + R^1/2 F'F R^1/2)``, and the
        inverse-gamma prior of the variances where these are estimated."""
        volume = 2.0 * float(np.sum(np.log(np.diag(self.root(variances)) / np.abs(np.diag(whitener)))))
        if self.prior_covariance is not None:
            return volume
        relative = variances / DEFAULT_VARIANCE
        return volume + float(np.sum(np.log(relative) + 1.0 / relative - 1.0))

    def fitted_variances(
        self, vector: FloatArray, square: float, named: float, near: FloatArray | None = None
    ) -> FloatArray:
        """Return the most likely variances ``(blocks,)`` for a residual with column weights ``vector (K,)`` and this
        sum of squares, by MacKay's fixed point from several starts, or from ``near (blocks,)``.

        Given other recordings, the remainder changes only by the default variance, and by a fraction of ``named``: the
        mean square of the named effects in units of the noise variance. No effect acts exactly as its columns state.
        """
        if self.prior_covariance is not None:
            return self.default_variances + _IMPERFECT**2 * named
        if not len(self.block) or not square > 0.0:
            return self.default_variances
        residual = self.crossed @ vector
        starts = self._starts if near is None else [(near, self.whitener(near))]
        solutions = [self._from(*start, residual, square) for start in starts]
        return min(solutions, key=lambda solution: solution[0])[1]

    def of_features(self, chosen: BoolArray) -> Remainder:
        """Return the remainder of the ``chosen (m,)`` features alone, about which other recordings say nothing."""
        block: IntArray = np.unique(self.block[chosen], return_inverse=True)[1]
        return Remainder(self.squared[np.ix_(chosen, chosen)], self.crossed[chosen], block, self.count)

    def gain(self, vector: FloatArray, square: float) -> float:
        """Gain of twice the log likelihood by the features in their most likely variances, for a residual with column
        weights ``vector (K,)`` and this sum of squares."""
        if not square > 0.0:
            return 0.0
        scores = [self._from(*start, self.crossed @ vector, square)[0] for start in self._starts]
        return self.count * float(np.log(square)) - min(scores)

    @cached_property
    def _starts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Initial variances and their whiteners."""
        starts = [start * np.ones(len(self.default_variances)) for start in _STARTS]
        return [(variances, self.whitener(variances)) for variances in starts]

    def _from(
        self, variances: FloatArray, whitener: FloatArray, residual: FloatArray, square: float
    ) -> tuple[float, FloatArray]:
        sizes = np.bincount(self.block).astype(np.float64)
        for _ in range(_ROUNDS):
            previous, white = variances, whitener @ residual
            noise = max(square - float(white @ white), 1e-9 * square) / self.count
            determined = sizes - np.bincount(self.block, np.sum(whitener**2, axis=0)) / variances
            variances = (np.bincount(self.block, (white @ whitener) ** 2) / noise + DEFAULT_VARIANCE) / (
                determined + 1.0
            )
            whitener = self.whitener(variances)
            if np.all(np.abs(np.log(variances / previous)) < _SETTLED):
                break
        noise_square = max(square - float(np.sum((whitener @ residual) ** 2)), 1e-9 * square)
        return self.count * float(np.log(noise_square)) + self._cost(whitener, variances), variances
