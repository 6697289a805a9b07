"""The noise floor without a model: half the variance of the differences between repeats of one motion."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import CubicSpline

from geomid_ros.gap.evidence.record import Records
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_SHORTEST_PERIOD = 1.0  # [s]
_LEAST_OVERLAP = 0.45  # of the shorter stretch, that is compared: two periods just fit into one stretch
_SURE = 2.0  # standard deviations of a standard deviation
_SAME = 0.01  # root mean square difference of repeated positions, in their standard deviation


@dataclass(frozen=True, eq=False)
class Repeats:
    """``noise (C,)``: standard deviation of each channel, NaN where no motion is repeated or it is not measured, from
    ``counts (C,)`` independent instants."""

    noise: FloatArray
    counts: FloatArray

    def floor(self, remainder: FloatArray) -> FloatArray:
        """The noise of each channel ``(C,)``, of which the standard deviation ``remainder (C,)`` of what a model leaves
        is another measure, but for what the model lacks.

        That measure has more data, so it stands unless the repeats say surely less: the smaller one of two that differ
        by chance is too small.
        """
        sure = self.noise * (1.0 + _SURE / np.sqrt(2.0 * np.maximum(self.counts, 1.0))) < remainder
        floor: FloatArray = np.where(sure | np.isnan(remainder), self.noise, remainder)
        return floor


def noise_by_repeats(model: MeasurementModel, records: Records) -> Repeats:
    """The noise of each channel, without a model.

    Two runs of a motion, in one stretch or in two, differ by the noise of both, whatever the robot does; so half their
    mean squared difference is the variance of the noise, coloured or not.
    """
    squares, counts = np.zeros((2, len(model.channels)))
    for first, second in combinations_with_replacement(records.dense, 2):
        values = [_measured(model, part) for part in (first, second)]
        delay = repeated_after(first, second)
        known = np.all(np.isfinite(values[0]), axis=0) & np.all(np.isfinite(values[1]), axis=0)
        if delay is None or not np.any(known):
            continue
        times, others = _seconds(first), _seconds(second)
        both = (times + delay >= others[0]) & (times + delay <= others[-1])
        again = CubicSpline(others, values[1][:, known])(times[both] + delay)
        squares[known] += 0.5 * np.sum((again - values[0][both][:, known]) ** 2, axis=0)
        counts[known] += np.count_nonzero(both)
    independent = len(records.samples) / max(1, sum(len(part) for part in records.dense))
    return Repeats(np.sqrt(squares / np.where(counts > 0.0, counts, np.nan)), independent * counts)


def repeated_after(first: Samples, second: Samples) -> float | None:
    """What to add to the time since the beginning of one stretch [s] to find its positions in another one, or later in
    the same one; None if the motion is not repeated."""
    step = float(np.median(np.diff(_seconds(first))))
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
    """Mean squared difference of ``a`` and of ``b`` so many rows later, all joints together."""
    start, end = max(0, -lag), min(len(a), len(b) - lag)
    return float(np.sum((b[start + lag : end + lag] - a[start:end]) ** 2)) / (end - start)


def _lowest(three: FloatArray) -> tuple[float, float]:
    """The lowest value of the parabola through three, and where it lies, in steps from the middle one."""
    before, here, after = three.tolist()
    bend = before - 2.0 * here + after
    offset = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return max(here - 0.25 * (before - after) * offset, 0.0), offset


def _seconds(part: Samples) -> FloatArray:
    seconds: FloatArray = (part.stamps - part.stamps[0]) * 1e-9
    return seconds


def _measured(model: MeasurementModel, part: Samples) -> FloatArray:
    """The measured numbers of all channels ``(N, C)``; NaN where not measured, and if some are sums of others."""
    if len(model.sensors) != len(model.mounted):
        return np.full((len(part), len(model.channels)), np.nan)
    parts = [part.effort] if model.layout.efforts else []
    parts += [part.wrenches[:, model.sensors.index(sensor), sensor.axis_indices] for sensor in model.mounted]
    return np.concatenate(parts, axis=1)
