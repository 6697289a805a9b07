"""The principal real branch of Lambert's W.

Through ``v = sqrt(1 + e z) - 1`` W is analytic from the branch point on, ``v = -1``: its nearest singularity lies at
``v = -2``. One polynomial in v therefore gives it to rounding up to v = 1, without a loop that ends by chance, without
exponentials, and for many arguments at once, here and in the compiled projection. It is zero where z is, with its
relative accuracy.
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.polynomial import polyval

from geomid_ros.types import FloatArray, frozen

NEAR = 3.0 / math.e  # the polynomial serves up to here, where v is 1
_DEGREE = 28
_TAYLOR = 56  # terms, of which the last is as large as rounding: they fall by halves
_HALLEY_STEPS = 8


@cache
def coefficients() -> FloatArray:
    """Coefficients ``(29,)`` of ``W/v`` for v from -1 to 1, from the constant on.

    They are its Taylor series, economised by Chebyshev polynomials.

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
    return frozen(chebyshev.cheb2poly(economised))


def lambert_w(z: FloatArray) -> FloatArray:
    """The solution ``w >= -1 (...)`` of ``w exp(w) = z`` for ``z >= -1/e (...)``; -1 for smaller arguments.

    Far from zero by Halley's iteration after Corless et al., "On the Lambert W function" (1996).
    """
    near = np.minimum(z, NEAR)
    v = np.maximum(math.e * near / (1.0 + np.sqrt(np.maximum(1.0 + math.e * near, 0.0))), -1.0)
    w = np.maximum(polyval(v, coefficients()) * v, -1.0)
    far = z > NEAR
    return np.where(far, _far(np.where(far, z, 1.0)), w) if np.any(far) else w


def _far(z: FloatArray) -> FloatArray:
    logarithm = np.log1p(z)
    w = logarithm * (1.0 - np.log1p(logarithm) / (2.0 + logarithm))
    for _ in range(_HALLEY_STEPS):
        exponential = np.exp(w)
        excess = w * exponential - z
        slope = exponential * (w + 1.0)
        w -= excess / (slope - 0.5 * excess * (w + 2.0) / (w + 1.0))
    return np.asarray(w)
