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

import numba
import numpy as np

from geomid_ros.geometry.eigen4 import jacobi_eigh
from geomid_ros.geometry.lambert import lambert_w
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.symmetric import COLUMNS, ROWS
from geomid_ros.types import FloatArray, IntArray

ROOT = 0
NO_ROOT_LOW = 1  # b lies above what the neighbourhood reaches: the multiplier stops at the lower end
NO_ROOT_HIGH = 2  # b lies below it

_MAX_STEPS = 100
_NOISE = 1e-14  # eigenvalues smaller than this share of the largest are zeros that came through rounding
_RELATIVE_TOLERANCE = 1e-14
_BRANCH_GAP = 1e-9  # 1 + W is not taken smaller: at the branch point slopes are infinite
_ROOT_HALF = math.sqrt(0.5)
_ROOT_TWO = math.sqrt(2.0)


@dataclass(frozen=True)
class Projection:
    """Projections of one point on N hyperplanes, to second order.

    ``half_squared (N,)`` is half the squared distance. ``tangent (N, D)`` is minus its gradient, which where
    ``status (N,)`` is :data:`ROOT` is the logarithm of the projected point. Its Hessian is the outer product of
    ``direction (N, D)`` with itself plus curvature, whose weighted sum over the rows is ``curvature (D, D)``.
    """

    half_squared: FloatArray
    tangent: FloatArray
    direction: FloatArray
    curvature: FloatArray
    status: IntArray


@numba.njit(cache=True, nogil=True)
def _constraint(
    multiplier: float, values: FloatArray, count: int, flat: float, offset: float
) -> tuple[float, float, float]:
    """C(L), its slope and its terms' size; ``flat`` is the sum of x^2 over the reals, ``offset`` C's constant part."""
    total = offset - multiplier * flat
    size = abs(offset) + abs(multiplier * flat)
    slope = -flat
    for k in range(count):
        s = values[k]
        w = lambert_w(multiplier * s)
        moved = s * math.exp(-w)
        total += moved
        size += abs(moved)
        slope -= moved * moved / max(1.0 + w, _BRANCH_GAP)
    return total, slope, size


@numba.njit(cache=True, nogil=True)
def _root(values: FloatArray, count: int, flat: float, offset: float) -> tuple[float, int, float]:
    """Root of C by Newton's method kept inside a shrinking bracket; its status; the excess C at the returned L."""
    largest = 0.0
    smallest = 0.0
    for k in range(count):
        largest = max(largest, values[k])
        smallest = min(smallest, values[k])
    noise = _NOISE * max(largest, -smallest)
    for k in range(count):
        if abs(values[k]) <= noise:
            values[k] = 0.0
    largest = largest if largest > noise else 0.0
    smallest = smallest if smallest < -noise else 0.0
    low = -1.0 / (math.e * largest) if largest > 0.0 else -math.inf
    high = -1.0 / (math.e * smallest) if smallest < 0.0 else math.inf
    total, slope, size = _constraint(0.0, values, count, flat, offset)
    if slope == 0.0:
        return 0.0, ROOT if total == 0.0 else (NO_ROOT_LOW if total < 0.0 else NO_ROOT_HIGH), total
    if total < 0.0 and low > -math.inf:
        excess, _, _ = _constraint(low, values, count, flat, offset)
        if excess < 0.0:
            return low, NO_ROOT_LOW, excess
    if total > 0.0 and high < math.inf:
        excess, _, _ = _constraint(high, values, count, flat, offset)
        if excess > 0.0:
            return high, NO_ROOT_HIGH, excess
    # With one sign of eigenvalues only and no flat direction C falls to -b's own value at infinity.
    if total > 0.0 and high == math.inf and flat == 0.0 and offset >= 0.0:
        return 0.0, NO_ROOT_HIGH, total
    if total < 0.0 and low == -math.inf and flat == 0.0 and offset <= 0.0:
        return 0.0, NO_ROOT_LOW, total
    if total > 0.0:
        low = 0.0
    else:
        high = 0.0
    multiplier = 0.0
    for _ in range(_MAX_STEPS):
        candidate = multiplier - total / slope
        if not (low <= candidate <= high):
            candidate = 0.5 * (low + high)  # finite: towards an infinite end C is convex and Newton stays inside
        if candidate == multiplier:
            break
        multiplier = candidate
        total, slope, size = _constraint(multiplier, values, count, flat, offset)
        if abs(total) <= _RELATIVE_TOLERANCE * size:
            break
        if total > 0.0:
            low = multiplier
        else:
            high = multiplier
    return multiplier, ROOT, total


@numba.njit(cache=True, nogil=True)
def _decompose(x: FloatArray, basis: FloatArray, values: FloatArray, work: FloatArray, vectors: FloatArray) -> None:
    """Eigenvalues of one link's X-bar with coordinates ``x (10,)``, and in ``basis (10, 10)`` the coordinates of the
    orthonormal symmetric matrices ``v_k v_l^T`` of its eigenvectors, in the order of ``symmetric``."""
    for k in range(10):
        i, j = ROWS[k], COLUMNS[k]
        work[i, j] = x[k] if k < 4 else _ROOT_HALF * x[k]
    jacobi_eigh(work, vectors)
    for k in range(4):
        values[k] = work[k, k]
    for pair in range(10):
        k, m = ROWS[pair], COLUMNS[pair]
        for entry in range(10):
            i, j = ROWS[entry], COLUMNS[entry]
            if pair < 4:
                product = vectors[i, k] * vectors[j, k]
            else:
                product = _ROOT_HALF * (vectors[i, k] * vectors[j, m] + vectors[i, m] * vectors[j, k])
            basis[pair, entry] = product if entry < 4 else _ROOT_TWO * product


@numba.njit(cache=True, nogil=True)
def _pair_curvature(s_k: float, s_l: float, w_k: float, w_l: float) -> float:
    """``(s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))`` with its limit for equal eigenvalues."""
    difference = s_k - s_l
    if abs(difference) > 1e-7 * (abs(s_k) + abs(s_l)):
        return 0.5 * (s_k + s_l) * (w_k - w_l) / difference
    middle = 0.5 * (w_k + w_l)
    return middle / (1.0 + middle) if middle > -1.0 else 0.0  # two extreme eigenvalues beyond the end: a kink


@numba.njit(cache=True, nogil=True)
def _bend_with_the_end(
    x: FloatArray,
    excited: IntArray,
    bases: FloatArray,
    lambert: FloatArray,
    extreme: int,
    multiplier: float,
    excess: float,
    curved: int,
    weight: float,
    curvature: FloatArray,
) -> None:
    """The part of the Hessian that arises because the end of the interval moves with the extreme eigenvalue.

    With u the logarithms of the eigenvalues' sizes, e the extreme one and ``L = -1/(e s_e)`` throughout:
    ``d2/du_k du_e = -W_k/(1 + W_k)``, ``d2/dq du_e = -L x`` on the reals, and
    ``d2/du_e^2 = 1 + L C - sum_(k != e) W_k^2/(1 + W_k) - sum (L x)^2``.
    """
    in_links = 4 * len(excited)
    mover = np.zeros(len(x))
    others = np.zeros(len(x))
    own = 1.0 + multiplier * excess
    for k in range(len(lambert)):
        bend = lambert[k] / (1.0 + lambert[k]) if k != extreme else 0.0
        own -= lambert[k] * bend
        for entry in range(10 if k < in_links else 1):
            column = 10 * excited[k // 4] + entry if k < in_links else curved - len(lambert) + k
            unit = bases[k // 4, k % 4, entry] if k < in_links else 1.0
            if k == extreme:
                mover[column] = unit
            else:
                others[column] += bend * unit
    for k in range(curved, len(x)):
        others[k] = multiplier * x[k]
        own -= others[k] * others[k]
    for i in range(len(x)):
        for j in range(i, len(x)):
            curvature[i, j] += weight * (own * mover[i] * mover[j] - mover[i] * others[j] - others[i] * mover[j])


@numba.njit(cache=True, nogil=True)
def _project_rows(
    normals: FloatArray,
    offsets: FloatArray,
    weights: FloatArray,
    links: int,
    positives: int,
    half_squared: FloatArray,
    tangent: FloatArray,
    direction: FloatArray,
    curvature: FloatArray,
    status: IntArray,
) -> None:
    """Fill the outputs for rows with the tangent coordinates ``normals``; ``offsets`` is the constant part of C.

    Output arrays arrive as zeros.
    """
    dimension = normals.shape[1]
    curved = 10 * links + positives
    values = np.empty(4 * links + positives)
    lambert = np.empty(4 * links + positives)
    toward = np.empty(4 * links + positives)
    along = np.empty(4 * links + positives)
    bases = np.empty((links, 10, 10))
    excited = np.empty(links, dtype=np.int64)
    bends = np.empty(10)
    work = np.empty((4, 4))
    vectors = np.empty((4, 4))
    for row in range(normals.shape[0]):
        x = normals[row]
        count = 0
        active = 0
        for link in range(links):
            start = 10 * link
            any_entry = False
            for k in range(start, start + 10):
                if x[k] != 0.0:
                    any_entry = True
                    break
            if any_entry:
                _decompose(x[start : start + 10], bases[active], values[count : count + 4], work, vectors)
                excited[active] = link
                count += 4
                active += 1
        for k in range(10 * links, curved):
            values[count] = x[k]
            count += 1
        flat = 0.0
        for k in range(curved, dimension):
            flat += x[k] * x[k]

        multiplier, state, excess = _root(values, count, flat, offsets[row])
        status[row] = state

        half = 0.5 * multiplier * multiplier * flat + (multiplier * excess if state != ROOT else 0.0)
        steepness = flat
        extreme = 0
        for k in range(count):
            s = values[k]
            w = lambert_w(multiplier * s)
            half += 0.5 * w * w
            toward[k] = -w
            w = max(w, _BRANCH_GAP - 1.0)  # the same in both parts of the Hessian: their infinities cancel
            lambert[k] = w
            along[k] = s * math.exp(-w) / (1.0 + w)
            steepness += along[k] * along[k] * (1.0 + w)
            if multiplier * s < multiplier * values[extreme]:
                extreme = k
        half_squared[row] = half
        if state != ROOT and count > 0:
            # The end of the interval moves with the extreme eigenvalue.
            toward[extreme] += multiplier * excess
            lambert[extreme] -= multiplier * excess  # minus the gradient: what the curvature between a pair is made of
        beyond = state != ROOT and multiplier != 0.0
        share = 1.0 / math.sqrt(steepness) if state == ROOT and steepness > 0.0 else 0.0

        for index in range(active):
            start = 10 * excited[index]
            basis = bases[index]
            first = 4 * index
            for k in range(4):
                for entry in range(10):
                    tangent[row, start + entry] += toward[first + k] * basis[k, entry]
                    direction[row, start + entry] += share * along[first + k] * basis[k, entry]
            for pair in range(10):
                k, m = first + ROWS[pair], first + COLUMNS[pair]
                bends[pair] = 0.0
                if not (beyond and k == extreme and m == extreme):
                    bends[pair] = weights[row] * _pair_curvature(values[k], values[m], lambert[k], lambert[m])
            for i in range(10):
                for j in range(i, 10):
                    total = 0.0
                    for pair in range(10):
                        total += bends[pair] * basis[pair, i] * basis[pair, j]
                    curvature[start + i, start + j] += total
        for k in range(positives):
            column = 10 * links + k
            w = lambert[4 * active + k]
            tangent[row, column] = toward[4 * active + k]
            direction[row, column] = share * along[4 * active + k]
            if not (beyond and extreme == 4 * active + k):
                curvature[column, column] += weights[row] * w / (1.0 + w)
        for k in range(curved, dimension):
            tangent[row, k] = -multiplier * x[k]
            direction[row, k] = share * x[k]
        if beyond and weights[row] != 0.0:
            moving = (extreme, multiplier, excess, curved, weights[row])
            _bend_with_the_end(x, excited[:active], bases, lambert[:count], *moving, curvature)


def project(
    manifold: ParameterManifold,
    point: Point,
    normals: FloatArray,
    targets: FloatArray,
    weights: FloatArray | None = None,
) -> Projection:
    """Project ``point`` on the hyperplanes with tangent coordinates ``normals (N, D)`` and targets b ``(N,)``.

    ``normals`` are the rows whitened at ``point`` (:meth:`ParameterManifold.whiten`); ``weights (N,)``, ones unless
    given, are those with which the rows' curvature is summed.
    """
    rows, dimension = normals.shape
    reals = manifold.real
    offsets = normals[:, reals] @ (point.reals / manifold.scales) - targets
    half, status = np.zeros(rows), np.zeros(rows, dtype=np.int64)
    tangent, direction = np.zeros((rows, dimension)), np.zeros((rows, dimension))
    curvature = np.zeros((dimension, dimension))
    _project_rows(
        np.ascontiguousarray(normals),
        offsets,
        np.ones(rows) if weights is None else np.ascontiguousarray(weights),
        manifold.links,
        manifold.positives,
        half,
        tangent,
        direction,
        curvature,
        status,
    )
    curvature += np.triu(curvature, 1).T
    return Projection(half, tangent, direction, curvature, status)
