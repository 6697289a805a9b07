"""The principal real branch of Lambert's W, compiled."""

from __future__ import annotations

import math

import numba

# Below this distance from the branch point -1/e the series is exact to rounding, above it Halley's step is safe.
_SERIES_LIMIT = 1e-4
_HALLEY_STEPS = 8


@numba.njit(cache=True, nogil=True, inline="never")
def lambert_w(z: float) -> float:
    """The solution ``w >= -1`` of ``w exp(w) = z`` for ``z >= -1/e``; -1 for smaller arguments.

    Halley's iteration after Corless et al., "On the Lambert W function" (1996), with their series at the branch
    point, where Halley's step loses digits.
    """
    from_branch = math.e * z + 1.0
    if from_branch <= 0.0:
        return -1.0
    if from_branch < 0.3:
        p = math.sqrt(2.0 * from_branch)
        tail = p * (-43.0 / 540.0 + p * (769.0 / 17280.0 - p * 221.0 / 8505.0))
        w = -1.0 + p * (1.0 + p * (-1.0 / 3.0 + p * (11.0 / 72.0 + tail)))
        if from_branch < _SERIES_LIMIT:
            return w
    elif z < 2.0:
        w = math.log1p(z) * (1.0 - 0.25 * math.log1p(abs(z)))
    else:
        logarithm = math.log(z)
        w = logarithm - math.log(logarithm) if logarithm > 1.0 else logarithm
    for _ in range(_HALLEY_STEPS):
        exponential = math.exp(w)
        excess = w * exponential - z
        slope = exponential * (w + 1.0)
        step = excess / (slope - 0.5 * excess * (w + 2.0) / (w + 1.0))
        w -= step
        if abs(step) <= 1e-15 * (1.0 + abs(w)):
            break
    return w
