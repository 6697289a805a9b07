"""The measurement noise: its autocorrelation, whitening by it, and its size without a model of the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.types import BoolArray, FloatArray, IntArray

_HIGHEST_ORDER = 6


@dataclass(frozen=True, eq=False)
class Autoregression:
    """A stationary autoregressive process: predictors of all orders up to its own, as Levinson's recursion makes them.

    ``predictors[k] (k,)`` weights the k values before, the nearest first; ``variances[k]`` is its error's.
    """

    predictors: tuple[FloatArray, ...]
    variances: FloatArray

    @staticmethod
    def white() -> Autoregression:
        """No correlation, variance 1."""
        return Autoregression((np.zeros(0),), np.ones(1))

    @staticmethod
    def fit(values: FloatArray, runs: list[slice]) -> Autoregression:
        """The process of the order that Akaike's criterion prefers, for the unbroken ``runs`` of ``values (N,)``."""
        count = sum(run.stop - run.start for run in runs)
        covariance = np.array([_covariance(values, runs, lag) for lag in range(_HIGHEST_ORDER + 1)])
        if count == 0 or covariance[0] <= 0.0:
            return Autoregression.white()
        predictors, variances = levinson(covariance)
        # Means over different pairs need not be the covariances of any process.
        possible = int(np.argmin(np.append(variances > 0.0, False)))
        variances = variances[:possible]
        orders = np.arange(len(variances))
        best = int(np.argmin(count * np.log(variances) + 2.0 * orders))
        return Autoregression(predictors[: best + 1], variances[: best + 1])

    @property
    def order(self) -> int:
        """Number of values before that a value depends on."""
        return len(self.variances) - 1

    def whiten(self, columns: FloatArray, runs: list[slice]) -> FloatArray:
        """Columns ``(N, K)`` less what the rows before predict, run by run, in units in which white noise of the
        process's innovations keeps its size; rows outside the runs are left out. The first rows of a run use the
        shorter predictors, so that none is lost."""
        parts = [self._whiten_run(columns[run]) for run in runs]
        return np.concatenate(parts) if parts else np.zeros((0, columns.shape[1]))

    def _whiten_run(self, rows: FloatArray) -> FloatArray:
        order = self.order
        result = rows.copy()
        for lag, weight in enumerate(self.predictors[order] if len(rows) > order else (), start=1):
            result[order:] -= weight * rows[order - lag : len(rows) - lag]
        for index in range(min(order, len(rows))):
            for lag, weight in enumerate(self.predictors[index], start=1):
                result[index] -= weight * rows[index - lag]
            result[index] *= np.sqrt(self.variances[order] / self.variances[index])
        return result


def _covariance(values: FloatArray, runs: list[slice], lag: int) -> float:
    """Mean product of values so many rows apart in the same run, 0 if there are none."""
    products = [
        values[run][lag:] * values[run][: run.stop - run.start - lag] for run in runs if run.stop - run.start > lag
    ]
    return float(np.mean(np.concatenate(products))) if products else 0.0


def levinson(covariance: FloatArray) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Predictors of orders 0 to p and the variances of their errors from ``covariance (p + 1,)`` at lags 0 to p."""
    predictor, variance = np.zeros(0), float(covariance[0])
    predictors, variances = [predictor], [variance]
    for order in range(1, len(covariance)):
        reflection = (covariance[order] - predictor @ covariance[order - 1 : 0 : -1]) / variance
        predictor = np.append(predictor - reflection * predictor[::-1], reflection)
        variance *= 1.0 - reflection**2
        predictors.append(predictor)
        variances.append(variance)
    return tuple(predictors), np.array(variances)


def runs_of(valid: BoolArray, segment: IntArray) -> list[slice]:
    """Unbroken runs of valid rows that belong to one segment."""
    starts = valid & np.append(True, ~valid[:-1] | (segment[1:] != segment[:-1]))
    ends = valid & np.append(~valid[1:] | (segment[1:] != segment[:-1]), True)
    return [slice(int(a), int(b) + 1) for a, b in zip(np.flatnonzero(starts), np.flatnonzero(ends), strict=True)]
