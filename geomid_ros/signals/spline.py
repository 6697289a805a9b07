"""Cubic splines through samples, without what scipy.interpolate loads."""

from __future__ import annotations

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.types import FloatArray


def spline(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Cubic spline through ``values (N, K)`` at rising ``times (N,)``, of which the first two and the last two pieces
    are one polynomial each, at the instants ``at (...)``: ``(..., K)``; a polynomial through three values or fewer."""
    from scipy.linalg import lapack  # noqa: PLC0415 takes long to load

    if len(times) < 4:
        coefficients = np.linalg.solve(np.vander(times - times[0]), values)
        return np.asarray(np.vander(np.ravel(at) - times[0], len(times)).reshape(*at.shape, -1) @ coefficients)
    steps = np.diff(times)
    slopes = np.diff(values, axis=0) / steps[:, None]
    first, last = steps[0] + steps[1], steps[-1] + steps[-2]
    below, above = np.append(steps[1:], last), np.append(first, steps[:-1])
    diagonal = np.concatenate([steps[1:2], 2.0 * (steps[1:] + steps[:-1]), steps[-2:-1]])
    wanted = np.empty(values.shape)
    wanted[1:-1] = 3.0 * (steps[1:, None] * slopes[:-1] + steps[:-1, None] * slopes[1:])
    wanted[0] = ((steps[0] + 2.0 * first) * steps[1] * slopes[0] + steps[0] ** 2 * slopes[1]) / first
    wanted[-1] = (steps[-1] ** 2 * slopes[-2] + (2.0 * last + steps[-1]) * steps[-2] * slopes[-1]) / last
    *_, tangents, failed = lapack.dgtsv(below, diagonal, above, wanted)
    if failed:
        raise LinAlgError("times do not rise")
    piece = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(steps) - 1)
    begin, end, step = tangents[piece], tangents[piece + 1], steps[piece][..., None]
    along = np.asarray(at - times[piece])[..., None]
    chord = slopes[piece]
    third = (begin + end - 2.0 * chord) / step**2
    second = (3.0 * chord - 2.0 * begin - end) / step
    return np.asarray(values[piece] + along * (begin + along * (second + along * third)))
