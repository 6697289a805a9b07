"""Measurement noise: its autocorrelation, whitening, and the noise floor from repeats of a motion.

Half the variance of the differences between repeats is that of the noise, whatever the robot does.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.gap.records import Records
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray, IntArray

_HIGHEST_ORDER = 6
_SHORTEST_PERIOD = 1.0  # [s]
_LEAST_OVERLAP = 0.45  # fraction of the shorter stretch to compare: two periods just fit into one stretch
_SAME = 0.01  # RMS difference of repeated positions, in their standard deviation


@dataclass(frozen=True, eq=False)
class Autoregression:
    """A stationary autoregressive process, with predictors of all orders up to its own from Levinson's recursion.

    ``predictors[k] (k,)`` weights the k previous values, the latest first; ``variances[k]`` is that of its error.
    """

    predictors: tuple[FloatArray, ...]
    variances: FloatArray

    @staticmethod
    def white() -> Autoregression:
        """White noise of variance 1."""
        return Autoregression((np.zeros(0),), np.ones(1))

    @staticmethod
    def fit(values: FloatArray, runs: list[slice]) -> Autoregression:
        """Fit the process to the unbroken ``runs`` of ``values (N,)``, with the order of Akaike's criterion."""
        count = sum(run.stop - run.start for run in runs)
        covariance = np.array([_covariance(values, runs, lag) for lag in range(_HIGHEST_ORDER + 1)])
        if count == 0 or covariance[0] <= 0.0:
            return Autoregression.white()
        with np.errstate(divide="ignore", invalid="ignore"):  # with few rows an error's variance may be zero
            predictors, variances = levinson(covariance)
        # Sample means over different pairs need not be the covariances of any process.
        possible = int(np.argmin(np.append(variances > 0.0, False)))
        variances = variances[:possible]
        orders = np.arange(len(variances))
        best = int(np.argmin(count * np.log(variances) + 2.0 * orders))
        return Autoregression(predictors[: best + 1], variances[: best + 1])

    @property
    def order(self) -> int:
        """Number of previous values on which a value depends."""
        return len(self.variances) - 1

    def whiten(self, columns: FloatArray, runs: list[slice]) -> FloatArray:
        """Subtract from columns ``(N, K)`` their prediction from the previous rows, run by run. White noise of the
        process's innovations keeps its size. Rows outside the runs are omitted. The first rows of a run use the shorter
        predictors, so that none is lost."""
        white = np.empty((sum(run.stop - run.start for run in runs), columns.shape[1]))
        begin = 0
        for run in runs:
            end = begin + run.stop - run.start
            self._whiten_run(columns[run], white[begin:end])
            begin = end
        return white

    def _whiten_run(self, rows: FloatArray, result: FloatArray) -> None:
        order = self.order
        result[:] = rows
        for lag, weight in enumerate(self.predictors[order] if len(rows) > order else (), start=1):
            result[order:] -= weight * rows[order - lag : len(rows) - lag]
        for index in range(min(order, len(rows))):
            for lag, weight in enumerate(self.predictors[index], start=1):
                result[index] -= weight * rows[index - lag]
            result[index] *= np.sqrt(self.variances[order] / self.variances[index])


def _covariance(values: FloatArray, runs: list[slice], lag: int) -> float:
    """Mean product of values ``lag`` rows apart in the same run, 0 if there are none."""
    products = [
        values[run][lag:] * values[run][: run.stop - run.start - lag] for run in runs if run.stop - run.start > lag
    ]
    return float(np.mean(np.concatenate(products))) if products else 0.0


def levinson(covariance: FloatArray) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Predictors of orders 0 to p and the variances of their errors, from ``covariance (p + 1,)`` at lags 0 to p."""
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
    """Return the unbroken runs of valid rows within one segment."""
    starts = valid & np.append(True, ~valid[:-1] | (segment[1:] != segment[:-1]))
    ends = valid & np.append(~valid[1:] | (segment[1:] != segment[:-1]), True)
    return [slice(int(a), int(b) + 1) for a, b in zip(np.flatnonzero(starts), np.flatnonzero(ends), strict=True)]


def noise_floor(model: MeasurementModel, records: Records, remainder: FloatArray) -> FloatArray:
    """Noise std of each channel ``(C,)``, given the std of a model's residual, ``remainder (C,)``, which also estimates
    the noise, apart from the model's remainder.

    It uses more data, so it is taken unless repeats of a motion give significantly less: the smaller of two estimates
    that differ by chance is too small.
    """
    noise, counts = noise_by_repeats(model, records)
    significant = noise * (1.0 + STDS_OF_95 / np.sqrt(2.0 * np.maximum(counts, 1.0))) < remainder
    return np.where(significant | np.isnan(remainder), noise, remainder)


def noise_by_repeats(model: MeasurementModel, records: Records) -> tuple[FloatArray, FloatArray]:
    """Noise std of each channel ``(C,)`` without a model, and the number of independent samples ``(C,)`` that it is
    from; NaN for channels that never change, are not measured, or whose motion is not repeated.

    Two runs of a motion, in one stretch or in two, differ by the noise of both, whatever the robot does. So half their
    mean squared difference is the variance of the noise, coloured or not.
    """
    squares, counts = np.zeros((2, len(model.channels)))
    for first, second in combinations_with_replacement(records.dense, 2):
        values = [_measured(model, part) for part in (first, second)]
        delay = repeated_after(first, second)
        measured = np.all(np.isfinite(values[0]), axis=0) & np.all(np.isfinite(values[1]), axis=0)
        measured &= np.any(values[0] != values[0][0], axis=0)
        if delay is None or not np.any(measured):
            continue
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 of repeats alone, takes long to load

        times, second_times = first.seconds, second.seconds
        overlap = (times + delay >= second_times[0]) & (times + delay <= second_times[-1])
        repeated = CubicSpline(second_times, values[1][:, measured])(times[overlap] + delay)
        squares[measured] += 0.5 * np.sum((repeated - values[0][overlap][:, measured]) ** 2, axis=0)
        counts[measured] += np.count_nonzero(overlap)
    independent = len(records.samples) / max(1, sum(len(part) for part in records.dense))
    return np.sqrt(squares / np.where(counts > 0.0, counts, np.nan)), independent * counts


def repeated_after(first: Samples, second: Samples) -> float | None:
    """Return the shift from the time since the beginning of one stretch [s] to that of a repeat in another one, or
    later in the same one; None if the motion is not repeated."""
    step = float(np.median(np.diff(first.seconds)))
    centre = np.mean(first.position, axis=0)
    a, b = first.position - centre, second.position - centre
    size = float(np.sum(np.mean(a**2, axis=0)))
    least = int(_LEAST_OVERLAP * min(len(a), len(b)))
    lags = range(round(_SHORTEST_PERIOD / step) if first is second else least - len(a), len(b) - least)
    if size == 0.0 or len(lags) < 3:
        return None
    differences = np.array([_difference(a, b, lag) for lag in lags]) / size
    lowest = int(np.argmin(differences[1:-1])) + 1
    value, offset = _lowest(differences[lowest - 1 : lowest + 2])
    inside = abs(offset) <= 1.0  # else it is the edge of what overlaps
    return (lags[lowest] + offset) * step if inside and value < _SAME**2 else None


def _difference(a: FloatArray, b: FloatArray, lag: int) -> float:
    """Mean squared difference of ``a`` and of ``b`` shifted by ``lag`` rows, summed over joints."""
    start, end = max(0, -lag), min(len(a), len(b) - lag)
    return float(np.sum((b[start + lag : end + lag] - a[start:end]) ** 2)) / (end - start)


def _lowest(three: FloatArray) -> tuple[float, float]:
    """Minimum of the parabola through three values, and its position in steps from the middle one."""
    before, middle, after = three.tolist()
    bend = before - 2.0 * middle + after
    offset = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return max(middle - 0.25 * (before - after) * offset, 0.0), offset


def _measured(model: MeasurementModel, part: Samples) -> FloatArray:
    """Measured values of all channels ``(N, C)``; NaN where not measured, and everywhere if some are sums of others."""
    if len(model.sensors) != len(model.mounted):
        return np.full((len(part), len(model.channels)), np.nan)
    parts = [part.effort] if model.layout.efforts else []
    parts += [part.wrenches[:, model.sensors.index(sensor), sensor.axis_indices] for sensor in model.mounted]
    return np.concatenate(parts, axis=1)
