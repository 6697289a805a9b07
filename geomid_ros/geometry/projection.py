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

from geomid_ros.geometry.eigen4 import BUFFER, LANES, MATRIX, VECTORS, jacobi_eigh
from geomid_ros.geometry.lambert import NEAR, lambert_near, lambert_w
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
_CLOSE = -0.3659  # below it W is next to the branch point, under -0.9
_ROOT_HALF = math.sqrt(0.5)

# Links are worked on in blocks of LANES, each in a buffer of its own. Entry by entry the links lie side by side, so
# that the compiler turns each operation into one on all of them. After the decomposition follow the basis of symmetric
# matrices that the eigenvectors make (ten coordinates of each of ten), the curvature in the direction of each, a sum of
# the first four with other sizes, and the sum of the curvatures over the rows.
_BASIS = BUFFER
_BENDS = _BASIS + 100 * LANES
_SUM = _BENDS + 10 * LANES
_SUMS = _SUM + 10 * LANES
_BLOCK = _SUMS + 100 * LANES
_VALUES = 4 * LANES


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


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _constraint(
    multiplier: float,
    values: FloatArray,
    ends: tuple[float, float],
    flat: float,
    offset: float,
    lambert: FloatArray,
    moved: FloatArray,
) -> tuple[float, float, float, float]:
    """C(L), its slope, its curvature and its terms' size.

    ``flat`` is the sum of x^2 over the reals, ``offset`` C's constant part. Of the values s, whose interval has these
    ``ends``, ``lambert`` receives ``W(L s)`` and ``moved`` ``s exp(-W)``, which is ``W/L``.
    """
    inverse = 1.0 / multiplier if multiplier != 0.0 else 0.0
    for k in range(len(values)):
        lambert[k] = lambert_near(multiplier * values[k])
        moved[k] = inverse * lambert[k] if multiplier != 0.0 else values[k]
    one, other = -multiplier / (math.e * ends[0]), -multiplier / (math.e * ends[1])  # the extremes of L s
    if max(one, other) > NEAR or min(one, other) < _CLOSE:
        _correct_extremes(multiplier, values, lambert, moved)
    total = offset - multiplier * flat
    size = abs(offset) + abs(multiplier * flat)
    slope = -flat
    bend = 0.0
    for k in range(len(values)):
        steep = moved[k] / max(1.0 + lambert[k], _BRANCH_GAP)
        total += moved[k]
        size += abs(moved[k])
        slope -= moved[k] * steep
        bend += steep * steep * steep * (3.0 + 2.0 * lambert[k])
    return total, slope, bend, size


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _correct_extremes(multiplier: float, values: FloatArray, lambert: FloatArray, moved: FloatArray) -> None:
    """W beyond the reach of ``lambert_near``; and ``s exp(-W)`` next to the branch point, where W is known less exactly
    and only what the exponential makes of it agrees with where the projection lands."""
    for k in range(len(values)):
        z = multiplier * values[k]
        if z > NEAR:
            lambert[k] = lambert_w(z)
            moved[k] = lambert[k] / multiplier
        elif z < _CLOSE:
            moved[k] = values[k] * math.exp(-lambert[k])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _interval(values: FloatArray) -> tuple[float, float]:
    """The ends of the interval of multipliers; values that are zero but for rounding are set to zero."""
    largest = 0.0
    smallest = 0.0
    for value in values:
        largest = max(largest, value)
        smallest = min(smallest, value)
    noise = _NOISE * max(largest, -smallest)
    for k in range(len(values)):
        if abs(values[k]) <= noise:
            values[k] = 0.0
    low = -1.0 / (math.e * largest) if largest > noise else -math.inf
    high = -1.0 / (math.e * smallest) if smallest < -noise else math.inf
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _root(
    values: FloatArray, flat: float, offset: float, lambert: FloatArray, moved: FloatArray
) -> tuple[float, int, float]:
    """Root of C by Halley's method kept inside a shrinking bracket; its status; the excess C at the returned L.

    ``lambert`` and ``moved`` receive what :func:`_constraint` makes of the values there.
    """
    low, high = ends = _interval(values)
    total, slope, bend, size = _constraint(0.0, values, ends, flat, offset, lambert=lambert, moved=moved)
    if slope == 0.0:
        return 0.0, ROOT if total == 0.0 else (NO_ROOT_LOW if total < 0.0 else NO_ROOT_HIGH), total
    # With one sign of eigenvalues only and no flat direction C falls to -b's own value at infinity.
    if total > 0.0 and high == math.inf and flat == 0.0 and offset >= 0.0:
        return 0.0, NO_ROOT_HIGH, total
    if total < 0.0 and low == -math.inf and flat == 0.0 and offset <= 0.0:
        return 0.0, NO_ROOT_LOW, total
    rising = total > 0.0
    end = high if rising else low
    low, high = (0.0, high) if rising else (low, 0.0)
    tried = False
    multiplier = 0.0
    for _ in range(_MAX_STEPS):
        if abs(total) <= _RELATIVE_TOLERANCE * size:
            break
        rate = slope - 0.5 * total * bend / slope
        candidate = multiplier - total / (rate if rate < 0.5 * slope else slope)
        if candidate == multiplier:
            break
        if not (low < candidate < high):
            if not tried and math.isfinite(end):
                excess, _, _, _ = _constraint(end, values, ends, flat, offset, lambert=lambert, moved=moved)
                if excess != 0.0 and (excess > 0.0) == rising:
                    return end, NO_ROOT_HIGH if rising else NO_ROOT_LOW, excess
                tried = True
            candidate = 0.5 * (low + high)  # finite: towards an infinite end C is convex and Newton stays inside
        multiplier = candidate
        total, slope, bend, size = _constraint(multiplier, values, ends, flat, offset, lambert=lambert, moved=moved)
        if total > 0.0:
            low = multiplier
        else:
            high = multiplier
    return multiplier, ROOT, total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _gather(x: FloatArray, first: int, links: int, block: FloatArray) -> bool:
    """Put the X-bar of the links from ``first`` on into ``block``; False if the row touches none of them."""
    touched = False
    for k in range(10 * first, 10 * min(first + LANES, links)):
        touched = touched or x[k] != 0.0
    if touched:
        for entry in range(10):
            factor = 1.0 if entry < 4 else _ROOT_HALF
            for lane in range(min(LANES, links - first)):
                block[MATRIX + entry * LANES + lane] = factor * x[10 * (first + lane) + entry]
            for lane in range(links - first, LANES):
                block[MATRIX + entry * LANES + lane] = 0.0
    return touched


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _make_basis(block: FloatArray) -> None:
    """Coordinates of the orthonormal ``v_k v_k^T`` and ``(v_k v_m^T + v_m v_k^T) / sqrt(2)`` of the eigenvectors v, in
    the order of ``symmetric``."""
    for pair in range(10):
        k, m = VECTORS + LANES * ROWS[pair], VECTORS + LANES * COLUMNS[pair]
        on, off = (0.5, _ROOT_HALF) if pair < 4 else (_ROOT_HALF, 1.0)
        first = _BASIS + 10 * LANES * pair
        for lane in range(LANES):
            v, u, place = k + lane, m + lane, first + lane
            v0, v1, v2, v3 = block[v], block[v + 4 * LANES], block[v + 8 * LANES], block[v + 12 * LANES]
            u0, u1, u2, u3 = block[u], block[u + 4 * LANES], block[u + 8 * LANES], block[u + 12 * LANES]
            block[place] = on * (v0 * u0 + u0 * v0)
            block[place + LANES] = on * (v1 * u1 + u1 * v1)
            block[place + 2 * LANES] = on * (v2 * u2 + u2 * v2)
            block[place + 3 * LANES] = on * (v3 * u3 + u3 * v3)
            block[place + 4 * LANES] = off * (v0 * u1 + u0 * v1)
            block[place + 5 * LANES] = off * (v0 * u2 + u0 * v2)
            block[place + 6 * LANES] = off * (v0 * u3 + u0 * v3)
            block[place + 7 * LANES] = off * (v1 * u2 + u1 * v2)
            block[place + 8 * LANES] = off * (v1 * u3 + u1 * v3)
            block[place + 9 * LANES] = off * (v2 * u3 + u2 * v3)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pair_curvatures(values: FloatArray, lambert: FloatArray, weight: float, block: FloatArray) -> None:
    """``(s_k + s_l)(W_k - W_l) / (2 (s_k - s_l))`` with its limit for equal eigenvalues, times ``weight``.

    The ``values`` s and ``lambert`` W are the four of every link of ``block``.
    """
    for pair in range(10):
        k, m = LANES * ROWS[pair], LANES * COLUMNS[pair]
        for lane in range(LANES):
            s_k, s_l = values[k + lane], values[m + lane]
            w_k, w_l = lambert[k + lane], lambert[m + lane]
            middle = 0.5 * (w_k + w_l)
            difference = s_k - s_l
            apart = abs(difference) > 1e-7 * (abs(s_k) + abs(s_l))
            above = middle > -1.0  # two extreme eigenvalues beyond the end: a kink
            numerator = 0.5 * (s_k + s_l) * (w_k - w_l) if apart else (middle if above else 0.0)
            denominator = difference if apart else (1.0 + middle if above else 1.0)
            block[_BENDS + LANES * pair + lane] = weight * numerator / denominator


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_curvature(block: FloatArray) -> None:
    """Add the links' curvatures to the upper triangles of their sums."""
    for i in range(10):
        for j in range(i, 10):
            for lane in range(LANES):
                term = 0.0
                for pair in range(10):
                    place = _BASIS + 10 * LANES * pair + lane
                    bend = block[_BENDS + LANES * pair + lane]
                    term += bend * block[place + LANES * i] * block[place + LANES * j]
                block[_SUMS + 10 * LANES * i + LANES * j + lane] += term


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _along_eigenvectors(block: FloatArray, sizes: FloatArray, first: int, links: int, result: FloatArray) -> None:
    """The coordinates of ``sum sizes_k v_k v_k^T`` of the links from ``first`` on, into ``result (D,)``."""
    for entry in range(10):
        place = _BASIS + LANES * entry
        for lane in range(LANES):
            block[_SUM + LANES * entry + lane] = (
                sizes[lane] * block[place + lane]
                + sizes[LANES + lane] * block[place + 10 * LANES + lane]
                + sizes[2 * LANES + lane] * block[place + 20 * LANES + lane]
                + sizes[3 * LANES + lane] * block[place + 30 * LANES + lane]
            )
    for lane in range(min(LANES, links - first)):
        for entry in range(10):
            result[10 * (first + lane) + entry] = block[_SUM + LANES * entry + lane]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bend_with_the_end(
    x: FloatArray,
    excited: IntArray,
    blocks: FloatArray,
    lambert: FloatArray,
    extreme: int,
    multiplier: float,
    excess: float,
    links: int,
    weight: float,
    curvature: FloatArray,
) -> None:
    """The part of the Hessian that arises because the end of the interval moves with the extreme eigenvalue.

    With u the logarithms of the eigenvalues' sizes, e the extreme one and ``L = -1/(e s_e)`` throughout:
    ``d2/du_k du_e = -W_k/(1 + W_k)``, ``d2/dq du_e = -L x`` on the reals, and
    ``d2/du_e^2 = 1 + L C - sum_(k != e) W_k^2/(1 + W_k) - sum (L x)^2``.
    """
    in_links = _VALUES * len(excited)
    mover = np.zeros(len(x))
    others = np.zeros(len(x))
    own = 1.0 + multiplier * excess
    for k in range(len(lambert)):
        bend = lambert[k] / (1.0 + lambert[k]) if k != extreme else 0.0
        own -= lambert[k] * bend
        index, place = k // _VALUES, k % _VALUES
        lane = place % LANES
        link = LANES * excited[index] + lane if k < in_links else 0
        if link >= links and k < in_links:
            continue
        for entry in range(10 if k < in_links else 1):
            column = 10 * link + entry if k < in_links else 10 * links + k - in_links
            unit = 1.0
            if k < in_links:
                unit = blocks[excited[index], _BASIS + 10 * (place - lane) + LANES * entry + lane]
            if k == extreme:
                mover[column] = unit
            else:
                others[column] += bend * unit
    for k in range(10 * links + len(lambert) - in_links, len(x)):
        others[k] = multiplier * x[k]
        own -= others[k] * others[k]
    for i in range(len(x)):
        for j in range(i, len(x)):
            curvature[i, j] += weight * (own * mover[i] * mover[j] - mover[i] * others[j] - others[i] * mover[j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _decompose(
    x: FloatArray, links: int, positives: int, blocks: FloatArray, excited: IntArray, values: FloatArray
) -> tuple[int, float]:
    """Eigenvectors of a row into the blocks that it touches, which are listed in ``excited``, and into ``values`` the
    eigenvalues block by block, then the positives. Returns the number of those blocks and the reals' sum of squares."""
    active = 0
    for index in range(len(blocks)):
        block = blocks[index]
        if _gather(x, LANES * index, links, block):
            jacobi_eigh(block)
            for k in range(_VALUES):
                values[_VALUES * active + k] = block[k]
            excited[active] = index
            active += 1
    for k in range(positives):
        values[_VALUES * active + k] = x[10 * links + k]
    flat = 0.0
    for k in range(10 * links + positives, len(x)):
        flat += x[k] * x[k]
    return active, flat


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _half_squared(multiplier: float, excess: float, flat: float, lambert: FloatArray) -> float:
    """The dual function at the multiplier; at a root the excess is zero but for rounding."""
    half = 0.5 * multiplier * multiplier * flat + multiplier * excess
    for w in lambert:
        half += 0.5 * w * w
    return half


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _measure_rows(
    normals: FloatArray, offsets: FloatArray, links: int, positives: int, half_squared: FloatArray, status: IntArray
) -> None:
    """The values alone of what :func:`_project_rows` computes."""
    blocks = np.zeros(((links + LANES - 1) // LANES, _BLOCK))
    excited = np.zeros(len(blocks), dtype=np.int64)
    room = np.zeros((3, _VALUES * len(blocks) + positives))
    for row in range(normals.shape[0]):
        active, flat = _decompose(normals[row], links, positives, blocks, excited, room[0])
        count = _VALUES * active + positives
        lambert = room[1, :count]
        multiplier, status[row], excess = _root(room[0, :count], flat, offsets[row], lambert, room[2, :count])
        half_squared[row] = _half_squared(multiplier, excess, flat, lambert)


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
    blocks = np.zeros(((links + LANES - 1) // LANES, _BLOCK))
    excited = np.zeros(len(blocks), dtype=np.int64)  # the blocks that the row touches
    room = np.zeros((5, _VALUES * len(blocks) + positives))
    for row in range(normals.shape[0]):
        x = normals[row]
        active, flat = _decompose(x, links, positives, blocks, excited, room[0])
        in_links = _VALUES * active
        count = in_links + positives
        values, toward, along = room[0, :count], room[1, :count], room[2, :count]
        lambert, moved = room[3, :count], room[4, :count]
        multiplier, status[row], excess = _root(values, flat, offsets[row], lambert, moved)
        half_squared[row] = _half_squared(multiplier, excess, flat, lambert)
        state = status[row]
        steepness = flat
        for k in range(count):
            w = lambert[k]
            toward[k] = -w
            w = max(w, _BRANCH_GAP - 1.0)  # the same in both parts of the Hessian: their infinities cancel
            lambert[k] = w
            along[k] = moved[k] / (1.0 + w)
            steepness += along[k] * moved[k]
        extreme = 0
        if state != ROOT and count > 0:
            # The end of the interval moves with the extreme eigenvalue.
            extreme = int(np.argmin(multiplier * values))
            toward[extreme] += multiplier * excess
            lambert[extreme] -= multiplier * excess  # minus the gradient: what the curvature between a pair is made of
        beyond = state != ROOT and multiplier != 0.0
        share = 1.0 / math.sqrt(steepness) if state == ROOT and steepness > 0.0 else 0.0
        for k in range(count):
            along[k] *= share

        for index in range(active):
            begin, end = _VALUES * index, _VALUES * (index + 1)
            first = LANES * excited[index]
            block = blocks[excited[index]]
            _make_basis(block)
            _along_eigenvectors(block, toward[begin:end], first, links, tangent[row])
            _along_eigenvectors(block, along[begin:end], first, links, direction[row])
            _pair_curvatures(values[begin:end], lambert[begin:end], weights[row], block)
            if beyond and begin <= extreme < end:
                block[_BENDS + extreme - begin] = 0.0
            _add_curvature(block)
        for k in range(positives):
            column = 10 * links + k
            w = lambert[in_links + k]
            tangent[row, column] = toward[in_links + k]
            direction[row, column] = along[in_links + k]
            if not (beyond and extreme == in_links + k):
                curvature[column, column] += weights[row] * w / (1.0 + w)
        for k in range(10 * links + positives, len(x)):
            tangent[row, k] = -multiplier * x[k]
            direction[row, k] = share * x[k]
        if beyond and weights[row] != 0.0:
            moving = (extreme, multiplier, excess, links, weights[row])
            _bend_with_the_end(x, excited[:active], blocks, lambert, *moving, curvature)
    for link in range(links):
        for i in range(10):
            for j in range(i, 10):
                total = blocks[link // LANES, _SUMS + LANES * (10 * i + j) + link % LANES]
                curvature[10 * link + i, 10 * link + j] += total


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
    half, status = np.zeros(rows), np.zeros(rows, dtype=np.int64)
    tangent, direction = np.zeros((rows, dimension)), np.zeros((rows, dimension))
    curvature = np.zeros((dimension, dimension))
    _project_rows(
        np.ascontiguousarray(normals),
        offsets,
        np.ones(rows) if weights is None else np.ascontiguousarray(weights),
        manifold.links,
        manifold.positives,
        half_squared=half,
        tangent=tangent,
        direction=direction,
        curvature=curvature,
        status=status,
    )
    curvature += np.triu(curvature, 1).T
    return Projection(half, tangent, direction, curvature, status)


def measure(
    manifold: ParameterManifold, point: Point, normals: FloatArray, targets: FloatArray
) -> tuple[FloatArray, IntArray]:
    """``half_squared`` and ``status`` of :func:`project` alone, for half the cost."""
    offsets = _offsets(manifold, point, normals, targets)
    half, status = np.zeros(len(normals)), np.zeros(len(normals), dtype=np.int64)
    _measure_rows(np.ascontiguousarray(normals), offsets, manifold.links, manifold.positives, half, status)
    return half, status


def _offsets(manifold: ParameterManifold, point: Point, normals: FloatArray, targets: FloatArray) -> FloatArray:
    """The constant part of C, ``(N,)``; a product of matrices would round a row differently in other company."""
    in_reals: FloatArray = np.sum(normals[:, manifold.real] * (point.reals / manifold.scales), axis=1)
    return in_reals - targets
