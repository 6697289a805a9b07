"""Cubic splines through what was sampled."""

from __future__ import annotations

import numpy as np

from geomid_ros.geometry import definite
from geomid_ros.types import FloatArray


def spline(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """The cubic spline through ``values (N, K)`` at ``times (N,)``, which increase, at the instants ``at (...)``,
    ``(..., K)``: without a knot at the second and the last time but one (de Boor, "A Practical Guide to Splines",
    chapter IV). Beyond the ends the cubics there go on; fewer than four values have the polynomial through them.

    The same as scipy.interpolate.CubicSpline, whose import takes as long as a short recording.
    """
    if len(times) < 4:
        return _polynomial(times, values, at)
    steps = np.diff(times)
    secants = np.diff(values, axis=0) / steps[:, None]
    slopes = _slopes(steps, secants)
    place = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(steps) - 1)
    bends = (slopes[:-1] + slopes[1:] - 2.0 * secants) / steps[:, None]
    cubic, square = bends / steps[:, None], (secants - slopes[:-1]) / steps[:, None] - bends
    since = (at - times[place])[..., None]
    return np.asarray(values[place] + since * (slopes[place] + since * (square[place] + since * cubic[place])))


def _slopes(steps: FloatArray, secants: FloatArray) -> FloatArray:
    """Of the spline at its knots ``(N, K)``, which make its second derivative continuous, and the third next to the
    ends."""
    middle = np.concatenate([steps[1:2], 2.0 * (steps[:-1] + steps[1:]), steps[-2:-1]])
    right = np.empty((len(middle), secants.shape[1]))
    right[1:-1] = 3.0 * (steps[1:, None] * secants[:-1] + steps[:-1, None] * secants[1:])
    first, last = steps[0] + steps[1], steps[-1] + steps[-2]
    right[0] = ((steps[0] + 2.0 * first) * steps[1] * secants[0] + steps[0] ** 2 * secants[1]) / first
    right[-1] = ((steps[-1] + 2.0 * last) * steps[-2] * secants[-1] + steps[-1] ** 2 * secants[-2]) / last
    return definite.solved_tridiagonal(np.append(steps[1:], last), middle, np.append(first, steps[:-1]), right)


def _polynomial(times: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """The polynomial through a few values (Lagrange)."""
    shares = [
        np.prod([(at - other) / (own - other) for other in times if other != own] or [np.ones(np.shape(at))], axis=0)
        for own in times
    ]
    return np.asarray(np.stack(shares, axis=-1) @ values)
