"""Projection of a point on many hyperplanes: Proposition 2, batched over rows and links, compiled.

A row is a hyperplane ``a . parameters = b``. In tangent coordinates at the point its normal is ``x = a J``
(:meth:`ParameterManifold.whiten`): per link the coordinates of ``X-bar`` with eigenvalues s_k, per positive
coefficient one such eigenvalue, per real coefficient a component of a flat direction. With the multiplier L and
``W`` the principal branch of Lambert's function, the projected point has the tangent coordinates

    Q = R diag(-W(L s)) R^T          (a link; a positive coefficient is the case of one eigenvalue)
    q = -L x                         (a real)

where L is the root of the decreasing function

    C(L) = sum s exp(-W(L s)) + sum (x r / scale - L x^2) - b

on the interval ``[-1/(e s_max), -1/(e s_min)]`` (infinite on a side without an eigenvalue of that sign). The
interval is the paper's neighbourhood B: no eigenvalue of ``P^-1 P-hat`` is above e. The sum over the reals
extends (21) to flat blocks.

**Where there is no root.** The half squared distance is the maximum over the interval of the concave dual function
``D(L) = sum W(L s)^2/2 + sum (L x)^2/2 + L C(L)``, whose slope is C. If the maximum is at an end of the interval, the
same formula continues the distance beyond the neighbourhood, linearly in b, with a continuous gradient. The paper
discards such rows; (19) does so at the prior (status :data:`NO_ROOT_LOW` or :data:`NO_ROOT_HIGH`). The continuation
keeps the objective finite and smooth if a kept row has no root at a later point of the iteration.

**Second order.** Along geodesics from the point, the half squared distance of one row has the Hessian

    p p^T / |C'(L)|  +  (per link, in the basis of the eigenvectors of X-bar)  (s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))

where p has the entries ``s_k exp(-W_k)/(1 + W_k)`` on the eigenvectors' diagonal and x on the reals. The second term
is ``W_k/(1 + W_k)`` for k = l and for a positive coefficient. The first term is the Gauss-Newton term; the second
vanishes with the distance. The Hessian follows from the second derivative of the spectral function D and the envelope
theorem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev

from geomid_ros.geometry import compiled, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_DEGREE = 28
_TAYLOR = 56  # number of terms; they halve from one to the next, and the last is as small as rounding


@cache
def coefficients() -> FloatArray:
    """Polynomial coefficients ``(29,)`` of ``W/v`` for v from -1 to 1, constant first.

    They are its Taylor series, economised by Chebyshev polynomials.

    ``u = 1 + W``, ``E = exp(W)`` and ``(u - 1) e E = (1 + v)^2 - 1`` imply ``e u E' = 2 (1 + v)`` and ``E u' = E'``.
    These equations give the terms of E and u one after the other.
    """
    with localcontext(prec=40):
        source = [2 / Decimal(1).exp()] * 2 + [Decimal(0)] * _TAYLOR
        u, power = [Decimal(1)], [Decimal(1)]
        for k in range(_TAYLOR):
            earlier = sum((u[j] * (k + 1 - j) * power[k + 1 - j] for j in range(1, k + 1)), Decimal(0))
            power.append((source[k] - earlier) / (k + 1))
            earlier = sum((power[j] * (k + 1 - j) * u[k + 1 - j] for j in range(1, k + 1)), Decimal(0))
            u.append(power[k + 1] - earlier / (k + 1))
    economised = chebyshev.poly2cheb(np.array(u[1:], dtype=np.float64))[: _DEGREE + 1]
    return frozen(chebyshev.cheb2poly(economised))


def lambert_w(z: FloatArray) -> FloatArray:
    """Compute the principal real branch of Lambert's W: ``w >= -1 (...)``, ``w exp(w) = z (...)``; -1 for ``z < -1/e``.

    As a function of ``v = sqrt(1 + e z) - 1``, W is analytic from the branch point ``v = -1`` on; its nearest
    singularity is at ``v = -2``. So the compiled projection computes it by one polynomial in v, up to v = 1:
    :func:`coefficients`.
    """
    from scipy.special import lambertw  # noqa: PLC0415 only without the compiled loops

    inside = z > -1.0 / math.e
    return np.where(inside, lambertw(np.where(inside, z, 0.0)).real, -1.0)


ROOT = 0
NO_ROOT_LOW = 1  # b is above the range of the neighbourhood: the multiplier stops at the lower end
NO_ROOT_HIGH = 2  # b is below that range: it stops at the upper end

_ROUNDING = 1e-14  # relative accuracy of a root; eigenvalues below this fraction of the largest are zeros
_BRANCH_GAP = 1e-9  # lower bound of 1 + W, because slopes are infinite at the branch point
_CLOSE = -0.3659  # below this argument W is near the branch point, under -0.9


@dataclass(frozen=True)
class Projection:
    """Projections of one point on N hyperplanes, to second order.

    Attributes:
        half_squared: Half the squared distances ``(N,)``.
        tangent: Negative gradients of these ``(N, D)``: the logarithms of the projected points, where these exist.
        direction: ``(N, D)``; a row's Hessian is the outer product of its direction with itself, plus its curvature.
        curvature: Weighted sum ``(D, D)`` of the rows' curvatures.
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
        manifold, point: Point to project, on its manifold.
        normals: Rows ``(N, D)`` whitened at ``point`` (:meth:`ParameterManifold.whiten`).
        targets: b ``(N,)``.
        weights: Weights of the rows' curvatures in their sum ``(N,)``; ones by default.
    """
    rows, dimension = normals.shape
    offsets = _offsets(manifold, point, normals, targets)
    weights = np.ones(rows) if weights is None else weights
    if compiled.native is None:
        with np.errstate(all="ignore"):  # such values are replaced, or their step is refused
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
    """Compute only ``half_squared`` and ``status`` of :func:`project`, at half the cost."""
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
    """Compute the constant part of C ``(N,)``. In a matrix product a row's rounding would depend on the other rows."""
    in_reals: FloatArray = np.sum(normals[:, manifold.real] * (point.reals / manifold.scales), axis=1)
    return in_reals - targets


class _Roots:
    """Roots of C for rows with tangent coordinates ``normals (N, D)`` and constant parts ``offsets (N,)`` of C, in
    numpy.

    Attributes:
        vectors: Eigenvectors of the links' X-bar ``(N, links, 4, 4)``.
        values: Eigenvalues s of the links, then the positives ``(N, K)``; zero if not above rounding.
        flat: Sums of x^2 over the reals ``(N,)``.
        multiplier, status, excess: L, its status, and C at L, ``(N,)``.
        lambert, moved: ``W(L s)`` and ``s exp(-W)``, ``(N, K)``.
    """

    def __init__(self, manifold: ParameterManifold, normals: FloatArray, offsets: FloatArray) -> None:
        count = len(normals)
        bars = spd.to_matrix(normals[:, manifold.inertial].reshape(count, manifold.links, spd.SIZE))
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
        """Dual function at the multiplier ``(N,)``; at a root the excess is zero up to rounding."""
        of_reals = 0.5 * self.multiplier**2 * self.flat + self.multiplier * self.excess
        return np.asarray(of_reals + 0.5 * np.sum(self.lambert**2, axis=1))

    @staticmethod
    def _lambert(values: FloatArray, multiplier: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute ``W(L s)`` and ``s exp(-W)``; near the branch point the latter by the exponential, which is more
        accurate there than the quotient W/L."""
        arguments = multiplier[:, None] * values
        lambert = lambert_w(arguments)
        moved = np.where(multiplier[:, None] != 0.0, lambert / multiplier[:, None], values)
        return lambert, np.where(arguments < _CLOSE, values * np.exp(-lambert), moved)

    def _constraint(self, rows: IntArray, multiplier: FloatArray) -> tuple[FloatArray, ...]:
        """Compute C(L) of ``rows (n,)`` at multipliers ``(n,)``, its slope and the size of its terms."""
        lambert, moved = self._lambert(self.values[rows], multiplier)
        steep = moved / np.maximum(1.0 + lambert, _BRANCH_GAP)
        of_reals, offset = multiplier * self.flat[rows], self._offsets[rows]
        return (
            offset - of_reals + np.sum(moved, axis=1),
            -self.flat[rows] - np.sum(moved * steep, axis=1),
            np.abs(offset) + np.abs(of_reals) + np.sum(np.abs(moved), axis=1),
        )

    def _without_root(self, total: FloatArray, slope: FloatArray) -> BoolArray:
        """Mark rows without a root at any L, given C and its slope at zero; True also where the slope is zero. If all
        eigenvalues have one sign and there is no flat direction, C falls to its constant part at infinity."""
        bounded = self.flat == 0.0
        above = (total > 0.0) & (self._high == np.inf) & bounded & (self._offsets >= 0.0)
        below = (total < 0.0) & (self._low == -np.inf) & bounded & (self._offsets <= 0.0)
        none = above | below | ((slope == 0.0) & (total != 0.0))
        self.status[none] = np.where(total[none] < 0.0, NO_ROOT_LOW, NO_ROOT_HIGH)
        return np.asarray(none | (slope == 0.0))

    def _find(self) -> None:
        """Find the multipliers and their status."""
        every = np.arange(len(self.multiplier))
        total, slope, size = self._constraint(every, self.multiplier)
        rising = total > 0.0
        ends = np.where(rising, self._high, self._low)
        searched = ~(self._without_root(total, slope) | (np.abs(total) <= _ROUNDING * size))
        bounded = np.flatnonzero(searched & np.isfinite(ends))
        excess = self._constraint(bounded, ends[bounded])[0]
        beyond = bounded[(excess != 0.0) & ((excess > 0.0) == rising[bounded])]
        self.status[beyond] = np.where(rising[beyond], NO_ROOT_HIGH, NO_ROOT_LOW)
        self.multiplier[beyond] = ends[beyond]
        searched[beyond] = False
        # Towards an infinite end C is convex: a Newton step from zero ends before the root.
        short = np.flatnonzero(searched & ~np.isfinite(ends))
        ends[short] = -total[short] / slope[short]
        while len(short):
            ends[short] *= 2.0
            before_root = (self._constraint(short, ends[short])[0] > 0.0) == rising[short]
            short = short[before_root & np.isfinite(ends[short])]
        from scipy.optimize.elementwise import find_root  # noqa: PLC0415 only without the compiled loops

        rows = np.flatnonzero(searched)
        self.multiplier[rows] = find_root(
            lambda multiplier, row: self._constraint(row.astype(np.int64), multiplier)[0],
            (np.zeros(len(rows)), ends[rows]),
            args=(rows,),
        ).x


def _project(manifold: ParameterManifold, normals: FloatArray, offsets: FloatArray, weights: FloatArray) -> Projection:
    """Compute :func:`project` in numpy."""
    roots = _Roots(manifold, normals, offsets)
    rows, has_root = np.arange(len(normals)), roots.status == ROOT
    beyond = ~has_root & (roots.multiplier != 0.0)
    tangent, lambert = -roots.lambert, np.maximum(roots.lambert, _BRANCH_GAP - 1.0)
    steep = roots.moved / (1.0 + lambert)
    steepness = roots.flat + np.sum(steep * roots.moved, axis=1)
    root_scale = np.where(has_root & (steepness > 0.0), 1.0 / np.sqrt(steepness), 0.0)
    first, in_links = spd.SIZE * manifold.links, 4 * manifold.links
    extreme = np.zeros(len(normals), dtype=np.int64)
    if roots.values.shape[1]:
        # The end of the interval moves with the extreme eigenvalue.
        extreme = np.argmin(roots.multiplier[:, None] * roots.values, axis=1)
        correction = np.where(has_root, 0.0, roots.multiplier * roots.excess)
        tangent[rows, extreme] += correction
        lambert[rows, extreme] -= correction  # negative gradient, for the curvatures between pairs
    diagonal = lambert / (1.0 + lambert)
    diagonal[beyond, extreme[beyond]] = 0.0
    basis = spd.congruence_matrix(np.swapaxes(roots.vectors, -1, -2))  # coordinates of pairs of eigenvectors, by rows

    def by_link(components: FloatArray) -> FloatArray:
        return components[:, :in_links].reshape(len(components), manifold.links, 4)

    def in_coordinates(components: FloatArray, reals: FloatArray) -> FloatArray:
        """Convert components ``(N, K)`` along eigenvectors and positives, and ``reals``, to tangent coordinates."""
        links = np.einsum("nlk,nlkc->nlc", by_link(components), basis[..., :4, :]).reshape(len(components), first)
        return np.concatenate([links, components[:, in_links:], reals], axis=1)

    pair_curvatures = _pair_curvatures(by_link(roots.values), by_link(lambert))
    pair_curvatures[..., :4] = by_link(diagonal)
    curvature = np.zeros((manifold.dimension,) * 2)
    blocks = np.einsum("n,nlp,nlpi,nlpj->lij", weights, pair_curvatures, basis, basis, optimize=True)
    manifold.add_blocks(curvature, blocks, np.append(weights @ diagonal[:, in_links:], np.zeros(len(manifold.scales))))
    moved = roots.multiplier[:, None] * normals[:, manifold.real]
    if np.any(beyond):
        # d2/du_k du_e = -W_k/(1 + W_k), d2/dq du_e = -L x, d2/du_e^2 = 1 + L C - sum_k W_k^2/(1 + W_k) - sum (L x)^2
        # by the logarithms u of the absolute eigenvalues; e is the extreme one.
        second = 1.0 + roots.multiplier * roots.excess - np.sum(lambert * diagonal, axis=1) - np.sum(moved**2, axis=1)
        unit = np.zeros(roots.values.shape)
        unit[rows, extreme] = 1.0
        axis = in_coordinates(unit, np.zeros(moved.shape))
        others, weight = in_coordinates(diagonal, moved), np.where(beyond, weights, 0.0)[:, None]
        mixed = (weight * axis).T @ others
        curvature += (weight * second[:, None] * axis).T @ axis - mixed - mixed.T
    return Projection(
        roots.half_squared,
        in_coordinates(tangent, -moved),
        root_scale[:, None] * in_coordinates(steep, normals[:, manifold.real]),
        0.5 * (curvature + curvature.T),
        roots.status,
    )


def _pair_curvatures(values: FloatArray, lambert: FloatArray) -> FloatArray:
    """Compute ``(s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))``, or its limit for equal eigenvalues, ``(..., 10)``, of the
    four ``values`` s and ``lambert`` W of each link ``(..., 4)``."""
    one, other = (values[..., pair] for pair in (spd.ROWS, spd.COLUMNS))
    of_one, of_other = (lambert[..., pair] for pair in (spd.ROWS, spd.COLUMNS))
    middle = 0.5 * (of_one + of_other)
    apart = np.abs(one - other) > 1e-7 * (np.abs(one) + np.abs(other))
    limit = np.where(middle > -1.0, middle / (1.0 + middle), 0.0)  # else a kink: two extreme eigenvalues beyond the end
    return np.where(apart, 0.5 * (one + other) * (of_one - of_other) / (one - other), limit)
