"""Parts of a recording without a pause."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from geomid_ros.model.samples import Samples
from geomid_ros.signals.kernels import LOWEST_RATE_PER_CUTOFF, derivative_kernels
from geomid_ros.types import FloatArray

_PAUSE = 1.5  # sampling periods
_SHORTEST = 0.25  # [s] a shorter part is not used


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples at equal distances of ``period`` [s]; ``times (N,)`` [s] from the first sample of all."""

    samples: Samples
    times: FloatArray
    period: float


def stretches(recordings: Iterable[Samples]) -> list[Stretch]:
    """The parts of recordings without a pause that are long enough to be simulated."""
    found = []
    for samples in recordings:
        steps = np.diff(samples.stamps)
        period = float(np.median(steps)) if len(steps) else 0.0
        starts = np.concatenate([[0], np.flatnonzero(steps > _PAUSE * period) + 1, [len(samples)]])
        for start, end in pairwise(starts.tolist()):
            if 1e-9 * (end - start) * period >= _SHORTEST:
                part = samples.select(slice(start, end))
                found.append(Stretch(part, 1e-9 * (part.stamps - part.stamps[0]), 1e-9 * period))
    return found


def interpolated(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic interpolation of ``values (N, K)`` at ``times (N,)`` to the instants ``at (...)``, ``(..., K)``.

    Columns that are not measured throughout are zero.
    """
    spline = CubicSpline(times, np.where(np.all(np.isfinite(values), axis=0), values, 0.0))
    result: FloatArray = spline(at)
    return result


def smoothed(values: FloatArray, period: float, cutoff: float) -> tuple[FloatArray, FloatArray]:
    """``values (N, K)``, a sample every ``period`` [s], below ``cutoff`` [Hz], and their rate."""
    kernels = derivative_kernels(min(cutoff, 1.0 / (LOWEST_RATE_PER_CUTOFF * period)), period)
    half = kernels.shape[1] // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, ((half, half), (0, 0)), "edge"), 2 * half + 1, 0)
    value, rate, _ = np.einsum("kl,ncl->knc", kernels, windows)
    return value, rate
