"""The principal real branch of Lambert's W, compiled.

Through ``v = sqrt(1 + e z) - 1`` W is analytic from the branch point on, ``v = -1``: its nearest singularity lies at
``v = -2``. One polynomial in v therefore gives it to rounding up to v = 1, without a loop that ends by chance, without
exponentials, and for many arguments at once. It is zero where z is, with its relative accuracy.
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numba
import numpy as np
from numpy.polynomial import chebyshev

from geomid_ros.types import FloatArray

NEAR = 3.0 / math.e  # the polynomial serves up to here, where v is 1
_DEGREE = 28
_TAYLOR = 56  # terms, of which the last is as large as rounding: they fall by halves
_HALLEY_STEPS = 8


def _polynomial() -> FloatArray:
    """Coefficients of ``W/v`` for v from -1 to 1: its Taylor series, economised by Chebyshev polynomials.

    With ``u = 1 + W``, ``E = exp(W)`` and ``(u - 1) e E = (1 + v)^2 - 1`` come ``e u E' = 2 (1 + v)`` and
    ``E u' = E'``, from which the terms of E and u follow one after the other.
    """
    with localcontext(prec=40):
        source = [2 / Decimal(1).exp()] * 2 + [Decimal(0)] * _TAYLOR
        u, power = [Decimal(1)], [Decimal(1)]
        for k in range(_TAYLOR):
            known = sum((u[j] * (k + 1 - j) * power[k + 1 - j] for j in range(1, k + 1)), Decimal(0))
            power.append((source[k] - known) / (k + 1))
            known = sum((power[j] * (k + 1 - j) * u[k + 1 - j] for j in range(1, k + 1)), Decimal(0))
            u.append(power[k + 1] - known / (k + 1))
    economised = chebyshev.poly2cheb(np.array(u[1:], dtype=np.float64))[: _DEGREE + 1]
    return np.asarray(chebyshev.cheb2poly(economised), dtype=np.float64)


_COEFFICIENTS = _polynomial()


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def lambert_near(z: float) -> float:
    """W for ``z <= NEAR``; -1 below its domain. Nothing branches."""
    v = max(math.e * z / (1.0 + math.sqrt(max(1.0 + math.e * z, 0.0))), -1.0)
    w: float = _COEFFICIENTS[_DEGREE]
    for k in range(_DEGREE - 1, -1, -1):
        w = w * v + _COEFFICIENTS[k]
    return max(w * v, -1.0)


@numba.njit(cache=True, nogil=True)
def lambert_w(z: float) -> float:
    """The solution ``w >= -1`` of ``w exp(w) = z`` for ``z >= -1/e``; -1 for smaller arguments.

    Far from zero by Halley's iteration after Corless et al., "On the Lambert W function" (1996).
    """
    if z <= NEAR:
        return lambert_near(z)
    logarithm = math.log1p(z)
    w = logarithm * (1.0 - math.log1p(logarithm) / (2.0 + logarithm))
    for _ in range(_HALLEY_STEPS):
        exponential = math.exp(w)
        excess = w * exponential - z
        slope = exponential * (w + 1.0)
        step = excess / (slope - 0.5 * excess * (w + 2.0) / (w + 1.0))
        w -= step
        if abs(step) <= 1e-15 * (1.0 + abs(w)):
            break
    return w
