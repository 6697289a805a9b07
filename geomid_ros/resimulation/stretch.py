"""Parts of a recording without a pause."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_SHORTEST = 0.25  # [s] a shorter part is not used


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples at equal distances of ``period`` [s]; ``times (N,)`` [s] from the first sample of all."""

    samples: Samples
    times: FloatArray
    period: float


def stretches(recordings: Iterable[Samples]) -> list[Stretch]:
    """The parts of recordings without a pause that are long enough to be simulated."""
    found: list[Stretch] = []
    for samples in recordings:
        period = 1e-9 * float(np.median(np.diff(samples.stamps))) if len(samples) > 1 else 0.0
        found += [
            Stretch(part, 1e-9 * (part.stamps - part.stamps[0]), period)
            for part in samples.stretches()
            if len(part) * period >= _SHORTEST
        ]
    return found


def interpolated(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic interpolation of ``values (N, K)`` at ``times (N,)`` to the instants ``at (...)``, ``(..., K)``.

    Columns that are not measured throughout are zero.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 takes long to load

    spline = CubicSpline(times, np.where(np.all(np.isfinite(values), axis=0), values, 0.0))
    return np.asarray(spline(at))
