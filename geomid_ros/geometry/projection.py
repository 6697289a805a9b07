"""Projection of a point on many hyperplanes: Proposition 2, batched over rows and links, compiled.

A row is a hyperplane ``a . parameters = b``. In tangent coordinates at the point its normal is ``x = a J``
(:meth:`ParameterManifold.whiten`): per link the coordinates of ``X-bar``, whose eigenvalues are s_k, per positive
coefficient one such eigenvalue, per real coefficient a component of a flat direction. With the multiplier L and
``W`` the principal branch of Lambert's function, the projected point lies at tangent coordinates

    Q = R diag(-W(L s)) R^T          (a link; a positive coefficient is the case of one eigenvalue)
    q = -L x                         (a real)

where L is the root of the decreasing function

    C(L) = sum s exp(-W(L s)) + sum (x r / scale - L x^2) - b

on the interval ``[-1/(e s_max), -1/(e s_min)]`` (infinite on a side without an eigenvalue of that sign), which
is the neighbourhood B of the paper: no eigenvalue of ``P^-1 P-hat`` above e. The sum over the reals is the
extension to flat blocks; the rest is (21).

**Where there is no root.** The half squared distance is the maximum over the interval of the concave dual function
``D(L) = sum W(L s)^2/2 + sum (L x)^2/2 + L C(L)``, whose slope is C; with the maximum at an end of the interval the
same formula continues the distance beyond the neighbourhood, linearly in b, with a continuous gradient. The paper
discards such rows; (19) does so at the prior (:data:`NO_ROOT_LOW`, :data:`NO_ROOT_HIGH` say which), and the
continuation keeps its objective finite and smooth when a later point of the iteration has no root for a row that was
kept.

**Second order.** Along geodesics from the point, the half squared distance of one row has the Hessian

    p p^T / |C'(L)|  +  (per link, in the basis of the eigenvectors of X-bar)  (s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))

where p has the entries ``s_k exp(-W_k)/(1 + W_k)`` on the eigenvectors' diagonal and x on the reals; the second
term is ``W_k/(1 + W_k)`` for k = l and for a positive coefficient. The first is the Gauss-Newton term, the second
vanishes with the distance. It follows from the second derivative of the spectral function D and the envelope theorem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.polynomial import polyval

from geomid_ros.geometry import compiled, symmetric
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

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
    """The principal real branch of Lambert's W, ``w >= -1 (...)`` with ``w exp(w) = z (...)``; -1 for ``z < -1/e``.

    Through ``v = sqrt(1 + e z) - 1`` W is analytic from the branch point on, ``v = -1``: its nearest singularity lies
    at ``v = -2``. One polynomial in v therefore gives it to rounding up to v = 1, without a loop that ends by chance,
    without exponentials, and for many arguments at once, here and in the compiled projection. It is zero where z is,
    with its relative accuracy. Far from zero by Halley's iteration after Corless et al., "On the Lambert W function"
    (1996).
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


ROOT = 0
NO_ROOT_LOW = 1  # b lies above what the neighbourhood reaches: the multiplier stops at the lower end
NO_ROOT_HIGH = 2  # b lies below it

_MAX_STEPS = 100
_ROUNDING = 1e-14  # of a root; eigenvalues smaller than this share of the largest are zeros that came through it
_BRANCH_GAP = 1e-9  # 1 + W is not taken smaller: at the branch point slopes are infinite
_CLOSE = -0.3659  # below it W is next to the branch point, under -0.9


@dataclass(frozen=True)
class Projection:
    """Projections of one point on N hyperplanes, to second order.

    Attributes:
        half_squared: Half the squared distances ``(N,)``.
        tangent: Minus their gradients ``(N, D)``: the logarithms of the projected points, where these exist.
        direction: ``(N, D)``; the Hessian of a row is the outer product of its direction with itself plus curvature.
        curvature: Sum ``(D, D)`` of the rows' curvature with their weights.
        status: ``(N,)``: :data:`ROOT`, :data:`NO_ROOT_LOW` or :data:`NO_ROOT_HIGH`.
    """

    half_squared: FloatArray
    tangent: FloatArray
    direction: FloatArray
    curvature: FloatArray
    status: IntArray


def project(
    manifold: ParameterManifold,
    point: Point,
    normals: FloatArray,
    targets: FloatArray,
    weights: FloatArray | None = None,
) -> Projection:
    """Project ``point`` on hyperplanes.

    Args:
        manifold, point: What is projected.
        normals: The rows ``(N, D)`` whitened at ``point`` (:meth:`ParameterManifold.whiten`).
        targets: b ``(N,)``.
        weights: With which the rows' curvature is summed, ``(N,)``; ones unless given.
    """
    rows, dimension = normals.shape
    offsets = _offsets(manifold, point, normals, targets)
    weights = np.ones(rows) if weights is None else weights
    if compiled.native is None:
        with np.errstate(all="ignore"):  # of values that are replaced, or of a step that is then refused
            return _project(manifold, normals, offsets, weights)
    half, status = np.empty(rows), np.empty(rows, dtype=np.int64)
    tangent, direction = np.zeros((rows, dimension)), np.zeros((rows, dimension))
    curvature = np.zeros((dimension, dimension))
    compiled.native.project(
        *(np.ascontiguousarray(normals), offsets, coefficients(), manifold.links, manifold.positives),
        *(np.ascontiguousarray(weights), half, tangent, direction, curvature, status),
    )
    curvature += np.triu(curvature, 1).T
    return Projection(half, tangent, direction, curvature, status)


def measure(
    manifold: ParameterManifold, point: Point, normals: FloatArray, targets: FloatArray
) -> tuple[FloatArray, IntArray]:
    """``half_squared`` and ``status`` of :func:`project` alone, for half the cost."""
    offsets = _offsets(manifold, point, normals, targets)
    if compiled.native is None:
        with np.errstate(all="ignore"):
            roots = _Roots(manifold, normals, offsets)
        return roots.half_squared, roots.status
    half, status = np.empty(len(normals)), np.empty(len(normals), dtype=np.int64)
    compiled.native.measure(
        *(np.ascontiguousarray(normals), offsets, coefficients(), manifold.links, manifold.positives), half, status
    )
    return half, status


def _offsets(manifold: ParameterManifold, point: Point, normals: FloatArray, targets: FloatArray) -> FloatArray:
    """The constant part of C, ``(N,)``; a product of matrices would round a row differently in other company."""
    in_reals: FloatArray = np.sum(normals[:, manifold.real] * (point.reals / manifold.scales), axis=1)
    return in_reals - targets


class _Roots:
    """Roots of C of rows with the tangent coordinates ``normals (N, D)`` and C's constant parts ``offsets (N,)``, by
    Halley's method kept inside a shrinking bracket; by numpy.

    Attributes:
        vectors: Eigenvectors of the links' X-bar ``(N, links, 4, 4)``.
        values: Eigenvalues s of the links, then the positives ``(N, K)``; zero where only rounding makes them more.
        flat: Sums of x^2 over the reals ``(N,)``.
        multiplier, status, excess: L, how it ended, and C there, ``(N,)``.
        lambert, moved: ``W(L s)`` and ``s exp(-W)``, ``(N, K)``.
    """

    def __init__(self, manifold: ParameterManifold, normals: FloatArray, offsets: FloatArray) -> None:
        count = len(normals)
        bars = symmetric.to_matrix(normals[:, manifold.inertial].reshape(count, manifold.links, symmetric.SIZE))
        values, self.vectors = np.linalg.eigh(bars)
        self.values = np.concatenate([values.reshape(count, 4 * manifold.links), normals[:, manifold.positive]], axis=1)
        largest, smallest = np.max(self.values, axis=1, initial=0.0), np.min(self.values, axis=1, initial=0.0)
        noise = _ROUNDING * np.maximum(largest, -smallest)
        self.values[np.abs(self.values) <= noise[:, None]] = 0.0
        self.flat = np.sum(normals[:, manifold.real] ** 2, axis=1)
        self._offsets = offsets
        self._low = np.where(largest > noise, -1.0 / (math.e * largest), -np.inf)
        self._high = np.where(smallest < -noise, -1.0 / (math.e * smallest), np.inf)
        self.multiplier, self.status = np.zeros(count), np.full(count, ROOT, dtype=np.int64)
        self._find()
        self.excess = self._constraint(np.arange(count), self.multiplier)[0]
        self.lambert, self.moved = self._lambert(self.values, self.multiplier)

    @property
    def half_squared(self) -> FloatArray:
        """The dual function at the multiplier ``(N,)``; at a root the excess is zero but for rounding."""
        of_reals = 0.5 * self.multiplier**2 * self.flat + self.multiplier * self.excess
        return np.asarray(of_reals + 0.5 * np.sum(self.lambert**2, axis=1))

    @staticmethod
    def _lambert(values: FloatArray, multiplier: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``W(L s)`` and ``s exp(-W)``: next to the branch point W is less exact than what the exponential makes of
        it."""
        arguments = multiplier[:, None] * values
        lambert = lambert_w(arguments)
        moved = np.where(multiplier[:, None] != 0.0, lambert / multiplier[:, None], values)
        return lambert, np.where(arguments < _CLOSE, values * np.exp(-lambert), moved)

    def _constraint(self, rows: IntArray, multiplier: FloatArray) -> tuple[FloatArray, ...]:
        """C(L) of these ``rows (n,)`` at multipliers ``(n,)``, its slope, its curvature and its terms' size."""
        lambert, moved = self._lambert(self.values[rows], multiplier)
        steep = moved / np.maximum(1.0 + lambert, _BRANCH_GAP)
        of_reals, offset = multiplier * self.flat[rows], self._offsets[rows]
        return (
            offset - of_reals + np.sum(moved, axis=1),
            -self.flat[rows] - np.sum(moved * steep, axis=1),
            np.sum(steep**3 * (3.0 + 2.0 * lambert), axis=1),
            np.abs(offset) + np.abs(of_reals) + np.sum(np.abs(moved), axis=1),
        )

    def _without_root(self, total: FloatArray, slope: FloatArray) -> BoolArray:
        """Which rows have no root whatever L is, by C and its slope at zero: with one sign of eigenvalues only and no
        flat direction, C falls to the constant part at infinity."""
        bounded = self.flat == 0.0
        above = (total > 0.0) & (self._high == np.inf) & bounded & (self._offsets >= 0.0)
        below = (total < 0.0) & (self._low == -np.inf) & bounded & (self._offsets <= 0.0)
        none = above | below | ((slope == 0.0) & (total != 0.0))
        self.status[none] = np.where(total[none] < 0.0, NO_ROOT_LOW, NO_ROOT_HIGH)
        return np.asarray(none | (slope == 0.0))

    def _find(self) -> None:
        """Find the multipliers and how they end."""
        every = np.arange(len(self.multiplier))
        total, slope, bend, size = self._constraint(every, self.multiplier)
        rising = total > 0.0
        ends = np.where(rising, self._high, self._low)
        low, high = np.where(rising, 0.0, self._low), np.where(rising, self._high, 0.0)
        searched = ~(self._without_root(total, slope) | (np.abs(total) <= _ROUNDING * size))
        tried = ~np.isfinite(ends)
        for _ in range(_MAX_STEPS):
            rate = slope - 0.5 * total * bend / slope
            candidate = self.multiplier - total / np.where(rate < 0.5 * slope, rate, slope)
            searched &= candidate != self.multiplier
            if not np.any(searched):
                return
            outside = searched & ~((low < candidate) & (candidate < high))
            asked = np.flatnonzero(outside & ~tried)
            excess = self._constraint(asked, ends[asked])[0]
            beyond = asked[(excess != 0.0) & ((excess > 0.0) == rising[asked])]
            self.status[beyond] = np.where(rising[beyond], NO_ROOT_HIGH, NO_ROOT_LOW)
            self.multiplier[beyond] = ends[beyond]
            searched[beyond] = False
            tried[asked] = True
            # The middle is finite: towards an infinite end C is convex and Newton stays inside.
            candidate = np.where(outside, 0.5 * (low + high), candidate)
            rows = np.flatnonzero(searched)
            self.multiplier[rows] = candidate[rows]
            total[rows], slope[rows], bend[rows], size[rows] = self._constraint(rows, candidate[rows])
            above = total > 0.0
            low = np.where(searched & above, self.multiplier, low)
            high = np.where(searched & ~above, self.multiplier, high)
            searched &= ~(np.abs(total) <= _ROUNDING * size)


def _project(manifold: ParameterManifold, normals: FloatArray, offsets: FloatArray, weights: FloatArray) -> Projection:
    """:func:`project` by numpy."""
    roots = _Roots(manifold, normals, offsets)
    every, found = np.arange(len(normals)), roots.status == ROOT
    beyond = ~found & (roots.multiplier != 0.0)
    toward, lambert = -roots.lambert, np.maximum(roots.lambert, _BRANCH_GAP - 1.0)
    along = roots.moved / (1.0 + lambert)
    steepness = roots.flat + np.sum(along * roots.moved, axis=1)
    share = np.where(found & (steepness > 0.0), 1.0 / np.sqrt(steepness), 0.0)
    first, in_links = symmetric.SIZE * manifold.links, 4 * manifold.links
    extreme = np.zeros(len(normals), dtype=np.int64)
    if roots.values.shape[1]:
        # The end of the interval moves with the extreme eigenvalue.
        extreme = np.argmin(roots.multiplier[:, None] * roots.values, axis=1)
        correction = np.where(found, 0.0, roots.multiplier * roots.excess)
        toward[every, extreme] += correction
        lambert[every, extreme] -= correction  # minus the gradient: what the curvature between a pair is made of
    bend = lambert / (1.0 + lambert)
    bend[beyond, extreme[beyond]] = 0.0
    basis = symmetric.congruence(np.swapaxes(roots.vectors, -1, -2))  # coordinates of pairs of eigenvectors, by rows

    def by_link(each: FloatArray) -> FloatArray:
        return each[:, :in_links].reshape(len(each), manifold.links, 4)

    def in_coordinates(each: FloatArray, reals: FloatArray) -> FloatArray:
        """Tangent coordinates of what is ``each (N, K)`` along the eigenvectors and the positives."""
        links = np.einsum("nlk,nlkc->nlc", by_link(each), basis[..., :4, :]).reshape(len(each), first)
        return np.concatenate([links, each[:, in_links:], reals], axis=1)

    bends = _pair_curvatures(by_link(roots.values), by_link(lambert))
    bends[..., :4] = by_link(bend)
    curvature = np.zeros((manifold.dimension,) * 2)
    blocks = np.einsum("n,nlp,nlpi,nlpj->lij", weights, bends, basis, basis, optimize=True)
    manifold.add_blocks(curvature, blocks, np.append(weights @ bend[:, in_links:], np.zeros(len(manifold.scales))))
    moved = roots.multiplier[:, None] * normals[:, manifold.real]
    if np.any(beyond):
        # d2/du_k du_e = -W_k/(1 + W_k), d2/dq du_e = -L x, d2/du_e^2 = 1 + L C - sum_k W_k^2/(1 + W_k) - sum (L x)^2
        # of the logarithms u of the eigenvalues' sizes, e the extreme one.
        own = 1.0 + roots.multiplier * roots.excess - np.sum(lambert * bend, axis=1) - np.sum(moved**2, axis=1)
        unit = np.zeros(roots.values.shape)
        unit[every, extreme] = 1.0
        mover = in_coordinates(unit, np.zeros(moved.shape))
        others, share_of = in_coordinates(bend, moved), np.where(beyond, weights, 0.0)[:, None]
        mixed = (share_of * mover).T @ others
        curvature += (share_of * own[:, None] * mover).T @ mover - mixed - mixed.T
    return Projection(
        roots.half_squared,
        in_coordinates(toward, -moved),
        share[:, None] * in_coordinates(along, normals[:, manifold.real]),
        0.5 * (curvature + curvature.T),
        roots.status,
    )


def _pair_curvatures(values: FloatArray, lambert: FloatArray) -> FloatArray:
    """``(s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))`` with its limit for equal eigenvalues, ``(..., 10)``, of the four
    ``values`` s and ``lambert`` W of each link ``(..., 4)``."""
    one, other = (values[..., pair] for pair in (symmetric.ROWS, symmetric.COLUMNS))
    of_one, of_other = (lambert[..., pair] for pair in (symmetric.ROWS, symmetric.COLUMNS))
    middle = 0.5 * (of_one + of_other)
    apart = np.abs(one - other) > 1e-7 * (np.abs(one) + np.abs(other))
    limit = np.where(middle > -1.0, middle / (1.0 + middle), 0.0)  # two extreme eigenvalues beyond the end: a kink
    return np.where(apart, 0.5 * (one + other) * (of_one - of_other) / (one - other), limit)
