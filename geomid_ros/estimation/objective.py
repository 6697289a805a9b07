"""Objectives: (19), weighted squared distances to the rows' hyperplanes and to the prior; and that of Remark 3."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from geomid_ros.geometry import compiled, projection, pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

# The kernels run without the GIL, so chunks run in parallel. Results do not depend on the number of cores, because the
# chunks are fixed and are summed in order.
_CHUNK = 512
_THREADS = 2
_pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="geomid-projection")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Half of an objective at a point: value, gradient ``(D,)``, and Hessian ``(D, D)`` along :meth:`Objective.step`.

    ``information``: the part of the Hessian that the rows contribute at distance zero (Gauss-Newton). With weights from
    true standard deviations it is the Fisher information of the rows.
    """

    value: float
    gradient: FloatArray
    information: FloatArray
    hessian: FloatArray


class Objective(Protocol):
    """Interface of the functions that a solver minimises."""

    @property
    def manifold(self) -> ParameterManifold:
        """Manifold of its points."""

    @property
    def scale(self) -> float:
        """Natural size of a gradient: the sum of all weights."""

    def evaluate(self, point: Point) -> Evaluation:
        """Return value, gradient and Hessian at ``point``."""

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """End of the step that leaves ``point`` with tangent coordinates ``(D,)``."""


@dataclass(frozen=True, eq=False)
class GeodesicObjective:
    """Objective (19); a row whose hyperplane has no projection from the prior is set aside.

    Attributes:
        manifold: Manifold of the parameters.
        rows, targets, sigmas: ``(N, D)``, ``(N,)`` and standard deviations ``(N,)`` of ``rows . parameters = targets``.
        prior: The point that distances are measured from.
        gamma: Weight of the prior as a fraction of the sum of the rows' weights.
        confidence: Multiplies gamma: one number, or one per coordinate ``(D,)``, equal within a block.
    """

    manifold: ParameterManifold
    rows: FloatArray
    targets: FloatArray
    sigmas: FloatArray
    prior: Point
    gamma: float
    confidence: FloatArray | float = 1.0

    @cached_property
    def prior_weights(self) -> FloatArray:
        """Factor of the squared distance to the prior per coordinate ``(D,)``."""
        return frozen(self.prior_weight * self.confidence * np.ones(self.manifold.dimension))

    @cached_property
    def weights(self) -> FloatArray:
        """Remark 2: ``w_i = a_i^T M^-1 a_i / sigma_i^2`` with M the metric at the prior; 0 for rows set aside."""
        return frozen(np.where(self.set_aside, 0.0, row_weights(self.manifold, self.prior, self.rows, self.sigmas)))

    @cached_property
    def set_aside(self) -> BoolArray:
        """True for rows ``(N,)`` that are not used, because Proposition 2 gives them no projection from the prior."""
        return np.asarray(self._at_prior[1] != projection.ROOT)

    @cached_property
    def value_at_prior(self) -> float:
        """Half of (19) at the prior."""
        return float(self.weights @ self._at_prior[0])

    @cached_property
    def _at_prior(self) -> tuple[FloatArray, IntArray]:
        return self._measure(self.prior)

    def _measure(self, point: Point) -> tuple[FloatArray, IntArray]:
        """Half of the squared distances to the hyperplanes, and how the projections ended, each ``(N,)``."""
        halves, statuses = np.empty(len(self.rows)), np.empty(len(self.rows), dtype=np.int64)

        def measure(chunk: slice) -> None:
            normals = self.manifold.whiten(point, self.rows[chunk])
            halves[chunk], statuses[chunk] = projection.measure(self.manifold, point, normals, self.targets[chunk])

        list(_pool.map(measure, _chunks(len(self.rows))))
        return halves, statuses

    @cached_property
    def prior_weight(self) -> float:
        """Factor of the squared distance to the prior in (19)."""
        return float(self.gamma * np.sum(self.weights))

    @cached_property
    def scale(self) -> float:
        """Sum of all weights."""
        return float(np.sum(self.weights)) + self.prior_weight

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """End of a geodesic step."""
        return self.manifold.exp(point, tangent)

    def evaluate(self, point: Point) -> Evaluation:
        """Return half of (19) at ``point`` with its derivatives in the tangent coordinates there."""
        value, gradient, bends = _prior_terms(self.manifold, point, self.prior, self.prior_weights)
        information = np.zeros((self.manifold.dimension,) * 2)
        hessian = np.zeros_like(information)
        self.manifold.add_blocks(hessian, bends, self.prior_weights[self.manifold.inertial.stop :])
        for terms in _pool.map(lambda chunk: self._row_terms(point, chunk), _chunks(len(self.rows))):
            value += terms[0]
            gradient = gradient + terms[1]
            information += terms[2]
            hessian += terms[3]
        return Evaluation(value, gradient, information, information + hessian)

    def _row_terms(self, point: Point, chunk: slice) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        weights = self.weights[chunk]
        normals = self.manifold.whiten(point, self.rows[chunk])
        projected = projection.project(self.manifold, point, normals, self.targets[chunk], weights)
        scaled = projected.direction * np.sqrt(weights)[:, None]
        return (
            float(weights @ projected.half_squared),
            -weights @ projected.tangent,
            scaled.T @ scaled,
            projected.curvature,
        )


@dataclass(frozen=True, eq=False)
class ResidualObjective:
    """Remark 3: ``sum (a_i . parameters - b_i)^2 / sigma_i^2 + gamma sum(w) d(Phi, Phi_0)^2``, weights as in (19).

    Near the prior, and where residuals are small against the measured values, it agrees with (19) to first order. Far
    from there it differs in two ways. It has no rows to set aside. And it does not reward what makes distances short,
    above all large masses: if all parameters are scaled, a row's residual grows in proportion, but the distance to its
    hyperplane does not. It depends on the rows only through their products: an evaluation costs no more for many rows
    than for few, but its rounding grows with the square of the rows' condition number.

    Attributes:
        manifold: Manifold of the parameters.
        products: Gram matrix ``(D + 1, D + 1)`` of the columns ``[A b]``, of rows of standard deviation 1.
        prior: The point that distances are measured from.
        prior_weights: ``(D,)``, the factors of the squared distance to the prior.
        rows_weight: Sum of the rows' weights (Remark 2).
        known: Products of the known rows, see :func:`products_at`.
    """

    manifold: ParameterManifold
    products: FloatArray
    prior: Point
    prior_weights: FloatArray
    rows_weight: float
    known: FloatArray | None = None

    @staticmethod
    def of(
        manifold: ParameterManifold, rows: FloatArray, targets: FloatArray, prior: Point, gamma: float
    ) -> ResidualObjective:
        """Build from ``rows (N, D)`` and ``targets (N,)`` of standard deviation 1; ``gamma``: weight of the prior as a
        fraction of the sum of the rows' weights."""
        augmented = np.column_stack([rows, targets])
        weight = float(np.sum(row_weights(manifold, prior, rows)))
        weights = np.full(manifold.dimension, gamma * weight)
        return ResidualObjective(manifold, augmented.T @ augmented, prior, weights, weight)

    @property
    def scale(self) -> float:
        """Sum of the rows' weights and the mean weight of the prior."""
        return self.rows_weight + float(np.mean(self.prior_weights))

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """End of a straight step, along which the rows' part is exactly quadratic."""
        return self.manifold.straight(point, tangent)

    def evaluate(self, point: Point) -> Evaluation:
        """Return half of the objective at ``point`` with its derivatives in the tangent coordinates there."""
        vector = np.append(point.parameters, -1.0)
        moved = self.products @ vector
        rows = 0.5 * float(vector @ moved), moved[:-1], self.products
        return with_prior(self.manifold, point, self.prior, self.prior_weights, rows, self.known)


def products_at(manifold: ParameterManifold, prior: Point, rows: FloatArray, targets: FloatArray) -> FloatArray:
    """Products ``(D + 1, D + 1)`` of rows ``(N, D)``, converted to rows of :meth:`ParameterManifold.offset` the prior,
    and of their residuals there. So known rows keep their precision in directions in which a link is thin."""
    converted = np.column_stack([manifold.offset_rows(prior, rows), rows @ prior.parameters - targets])
    products = np.zeros((manifold.dimension + 1, manifold.dimension + 1))
    # Rows of few links have few products, and those of the same links follow each other.
    links = np.any(rows[:, manifold.inertial].reshape(len(rows), manifold.links, spd.SIZE), axis=2)
    for part in np.split(converted, 1 + np.flatnonzero(np.any(links[1:] != links[:-1], axis=1))):
        (used,) = np.nonzero(np.any(part, axis=0))
        products[used[:, None], used] += part[:, used].T @ part[:, used]
    return products


def dual_metric(manifold: ParameterManifold, point: Point) -> FloatArray:
    """Dual metric M^-1 ``(D, D)`` at ``point``. Its Frobenius product with the products of rows of standard deviation 1
    is the sum of their weights (Remark 2)."""
    blocks, diagonal = manifold.jacobian(point)
    metric = np.zeros((manifold.dimension, manifold.dimension))
    manifold.add_blocks(metric, blocks @ np.swapaxes(blocks, -1, -2), diagonal**2)
    return metric


def row_weights(
    manifold: ParameterManifold, prior: Point, rows: FloatArray, sigmas: FloatArray | float = 1.0
) -> FloatArray:
    """Weights ``(N,)`` of Remark 2, for standard deviations ``sigmas (N,)``."""
    weights = np.empty(len(rows))
    for chunk in _chunks(len(rows)):
        weights[chunk] = np.sum(manifold.whiten(prior, rows[chunk]) ** 2, axis=1)
    return np.asarray(weights / sigmas**2)


def _chunks(count: int) -> Iterator[slice]:
    for start in range(0, count, _CHUNK):
        yield slice(start, start + _CHUNK)


def _prior_terms(
    manifold: ParameterManifold, point: Point, prior: Point, weights: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Half the weighted squared distance, its gradient, and the links' blocks of its Hessian along geodesics.

    Weights ``(D,)`` are equal within a block, so that the Hessian stays symmetric.
    """
    to_prior, bends = manifold.log_and_hessian(point, prior)
    bends = weights[manifold.inertial].reshape(-1, spd.SIZE, 1) * bends
    return 0.5 * float(weights @ to_prior**2), -weights * to_prior, bends


_PRODUCTS = 0.5 * np.einsum("kim,lmj->klij", spd.UNITS, spd.UNITS).reshape(spd.SIZE, spd.SIZE, -1)
_PRODUCTS = (_PRODUCTS + _PRODUCTS.transpose(1, 0, 2)).reshape(-1, _PRODUCTS.shape[-1])


def with_prior(
    manifold: ParameterManifold,
    point: Point,
    prior: Point,
    weights: FloatArray,
    rows: tuple[float, FloatArray, FloatArray],
    known: FloatArray | None,
) -> Evaluation:
    """Evaluate half of an objective along straight lines: the rows' part plus the weighted squared distance to a prior.

    Args:
        manifold, point, prior: Manifold, point of evaluation, and the point that distances are measured from.
        weights: Weights ``(D,)`` of the tangent coordinates to the prior, equal within a link.
        rows: Half of the rows' part, its derivative ``(D,)`` by the parameters, and the Gram matrix ``(D + 1, D + 1)``
            of their columns and targets.
        known: Products of the known rows (:func:`products_at`), if there are any.
    """
    value, slope, products = rows
    known = np.zeros(products.shape) if known is None else known
    off = np.append(manifold.offset(prior, point), 1.0)
    pull = known @ off
    value += 0.5 * float(off @ pull)
    if compiled.native is None:
        return _with_prior(manifold, point, prior, weights, (value, slope, products), (pull[:-1], known[:-1, :-1]))
    size = manifold.dimension
    gradient, information, hessian = np.empty(size), np.empty((size, size)), np.empty((size, size))
    start = manifold.inertial.stop
    value += compiled.native.second_order(
        *(pseudo_inertia.COEFFICIENTS_TO_COORDINATES, prior.to_tangent, point.pseudo_inertias, prior.pseudo_inertias),
        *(point.parameters[start:], prior.parameters[start:], manifold.scales, weights, slope, products, pull, known),
        *(gradient, information, hessian),
    )
    return Evaluation(value, gradient, information, hessian)


def _with_prior(
    manifold: ParameterManifold,
    point: Point,
    prior: Point,
    weights: FloatArray,
    rows: tuple[float, FloatArray, FloatArray],
    known: tuple[FloatArray, FloatArray],
) -> Evaluation:
    """Compute :func:`with_prior` by numpy; ``known``: derivative and products ``(D, D)`` of the known rows.

    Along a straight line the rows have no curvature but their information. The prior has the curvature of its weighted
    squared distance along geodesics, and that of the line. The latter belongs to the linear function of the parameters
    whose gradient is minus the prior's. Per link ``tr(X exp(tQ))`` has the second derivative ``tr(X Q^2)``; for a
    positive coefficient the second derivative equals the first.
    """
    value, slope, products = rows
    prior_value, gradient, bends = _prior_terms(manifold, point, prior, weights)
    information = manifold.whiten(point, manifold.whiten(point, products[:-1, :-1]).T)
    information += manifold.whiten_offset_rows(prior, point, manifold.whiten_offset_rows(prior, point, known[1]).T)
    slopes = manifold.whiten(point, slope[None])[0] + manifold.whiten_offset_rows(prior, point, known[0][None])[0]
    matrices = spd.to_matrix(-gradient[manifold.inertial].reshape(manifold.links, spd.SIZE))
    line_bends = (matrices.reshape(manifold.links, _PRODUCTS.shape[1]) @ _PRODUCTS.T).reshape(bends.shape)
    rest = weights[manifold.inertial.stop :].copy()
    rest[: manifold.positives] -= gradient[manifold.positive]
    hessian = information.copy()
    manifold.add_blocks(hessian, bends + line_bends, rest)
    return Evaluation(value + prior_value, gradient + slopes, information, hessian)
