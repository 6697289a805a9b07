"""Uncertainty of an estimate: the covariance of its error in the tangent space, and what the data contribute to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.estimate import FINEST, LinksInformation
from geomid_ros.estimation.solvers import Extrapolation
from geomid_ros.geometry import definite, pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.dynamics import STEP
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray, frozen

_LARGEST_SPREAD = 100.0  # times the usual: beyond it nothing is known, and rounding is all
_ROUNDS = 10  # of the fixed point; a fixed number, so that rounding cannot change how many there are
_FOLDS_OF_BLOCKS = (1, 2, 4)
"""Correlations that are longer than a block hide in it: of blocks of several lengths, those count that show most."""
_DOUBT = 3.0  # times as large as they are taken to be the prior's errors may be, if the data alone are believed
_ROUNDING = float(np.finfo(float).eps)  # of the largest information: what rounding may make of none
# Directions of less variance are not distinguished: a share of all of the variance there is.
_FLOOR = 1e-4


@dataclass(frozen=True, eq=False)
class Fold:
    """A block of time at the estimate: half the ``gradient (D,)`` of its rows' squared residuals, and their
    ``information (D, D)``, in tangent coordinates."""

    gradient: FloatArray
    information: FloatArray


@dataclass(frozen=True, eq=False)
class ParameterGroup:
    """Tangent coordinates ``columns`` with priors of equal spread, which usually is ``usual_spread``."""

    columns: IntArray
    usual_spread: float


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty at an estimate, in tangent coordinates.

    Attributes:
        covariance: ``(D, D)`` of the estimate's error.
        inherited: The part of it that the prior's error makes.
        prior: Covariance ``(D, D)`` of the prior's error.
        share: Share of the measured rows' information that correlations leave, 0 to 1.
        by_rows: Information ``(D,)`` that the rows have of each coordinate, the others within their priors.
    """

    covariance: FloatArray
    inherited: FloatArray
    prior: FloatArray
    share: float
    by_rows: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def doubted(self) -> FloatArray:
        """See :func:`doubted`."""
        return doubted(self.covariance, self.inherited)

    @property
    def prior_spreads(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error."""
        return np.asarray(np.sqrt(np.diag(self.prior)))

    def from_data(self, columns: slice) -> float:
        """The share of the prior's variance in these coordinates that the data removed, 0 to 1.

        Per principal direction, and on average. Where the prior has the weight that its spread deserves, this is the
        trace of the resolution matrix over its size.
        """
        root = np.linalg.inv(np.linalg.cholesky(self.prior[columns, columns]))
        left = np.linalg.eigvalsh(root @ self.covariance[columns, columns] @ root.T)
        return float(np.mean(np.clip(1.0 - left, 0.0, 1.0)))


def estimate_uncertainty(
    folds: Sequence[Fold],
    known: Fold,
    trust: float,
    prior_weights: FloatArray,
    from_prior: FloatArray,
    groups: Sequence[ParameterGroup],
    *,
    least_inflation: float = 1.0,
    assumed_spreads: FloatArray | float = 0.0,
    expected: FloatArray | float = 0.0,
) -> Uncertainty:
    """Uncertainty of a regularised estimate.

    Per group two numbers are estimated from the data: the factor by which correlated residuals make errors larger than
    independent ones would (:func:`variance_inflation`), and the spread of the prior's errors (:func:`prior_spreads`).
    Few blocks of time and few links tell both roughly, so that neither is less than what is known without them.

    Args:
        folds: The measured rows by blocks of time.
        known: Rows whose errors are independent and of known size.
        trust: Weight of the known rows in the objective.
        prior_weights: Factors ``(D,)`` of the squared distance to the prior.
        from_prior: Tangent coordinates ``(D,)`` of the prior at the estimate.
        groups: A partition of all coordinates.
        least_inflation: The factor that the filter of the rows is known to cause.
        assumed_spreads: Standard deviations ``(D,)`` of the prior's error with which the estimate was made.
        expected: Information ``(D, D)`` of those known rows that belong to the prior.
    """
    weights = np.maximum(prior_weights, np.finfo(float).tiny)
    measured = _sum(folds, len(weights))
    information = measured.information + trust * known.information
    inverse = information_inverse(information, weights)
    blocks = [_together(folds, count) for count in _FOLDS_OF_BLOCKS]
    each = [variance_inflation(many, information, inverse, weights, groups, least_inflation) for many in blocks]
    factors = np.max(each, axis=0)
    share = 1.0 / float(np.mean(factors))
    independent = Fold(share * measured.gradient + known.gradient, share * measured.information + known.information)
    spreads = np.maximum(prior_spreads(independent, from_prior, groups), assumed_spreads)
    parts = measured.information, trust, known.information
    noise, inherited = error_covariance(inverse, *parts, factors, weights * spreads)
    covariance = noise + inherited
    prior = information_inverse(np.zeros_like(covariance) + expected, spreads**-2.0)
    by_rows = np.maximum(1.0 / np.diag(inverse) - weights, 0.0) / factors
    return Uncertainty(covariance, inherited, prior, share, by_rows)


def _together(folds: Sequence[Fold], count: int) -> list[Fold]:
    """Blocks of so many consecutive folds."""
    return [_sum(folds[first : first + count], len(folds[0].gradient)) for first in range(0, len(folds), count)]


def _sum(folds: Sequence[Fold], dimension: int) -> Fold:
    gradient = sum((fold.gradient for fold in folds), np.zeros(dimension))
    return Fold(gradient, sum((fold.information for fold in folds), np.zeros((dimension, dimension))))


def error_covariance(
    inverse: FloatArray, measured: FloatArray, trust: float, known: FloatArray, factors: FloatArray, pulls: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance ``(D, D)`` of the estimate's error ``H^-1 (noise + W error of the prior)``: its two parts.

    With ``W = 1 / spreads^2``, and all factors and trust 1, they add up to ``H^-1``, the Bayesian posterior.

    Args:
        inverse: ``(D, D)`` of H, which is ``measured + trust known + W``.
        measured, known: Information ``(D, D)`` of the rows. The noise of the measured rows has the covariance
            ``measured``, enlarged by ``factors``.
        trust: Weight of the known rows.
        factors: Variance inflation ``(D,)``.
        pulls: Standard deviations ``(D,)`` of the prior's error, times the prior's weights, the diagonal of W.
    """
    of_rows = np.sqrt(factors)[:, None] * (inverse @ _root(measured))
    of_known = trust * (inverse @ _root(known))
    of_prior = inverse * pulls
    return of_rows @ of_rows.T + of_known @ of_known.T, of_prior @ of_prior.T


def doubted(covariance: FloatArray, inherited: FloatArray) -> FloatArray:
    """The covariance ``(D, D)`` of an estimate's error if the prior's errors, of which a part of it is ``inherited``,
    were three times as large: what is known even so is known from the data."""
    return covariance + (_DOUBT**2 - 1.0) * inherited


def _root(information: FloatArray) -> FloatArray:
    """A matrix that times its transpose is ``information``; eigenvalues that rounding made negative are zero."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def information_inverse(information: FloatArray, weights: FloatArray) -> FloatArray:
    """``(information + W)^-1`` for any weights above zero: rounding cannot make it indefinite."""
    units = np.sqrt(weights)
    values, vectors = np.linalg.eigh(information / np.outer(units, units))
    vectors = vectors / units[:, None]
    return np.asarray((vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T)


def _solved(information: FloatArray, weights: FloatArray, gradient: FloatArray) -> FloatArray:
    """``(information + W)^-1 gradient``, as :func:`information_inverse` is right for any weights above zero."""
    units = np.sqrt(weights)
    scaled = information / np.outer(units, units)
    np.fill_diagonal(scaled, np.diag(scaled) + _own_part(scaled))
    return np.asarray(definite.solved_anyway(scaled, gradient / units) / units)


def _own_part(scaled: FloatArray) -> float:
    """What the prior adds to each diagonal entry of an information in units of its spreads: one, and what rounding may
    have taken from the information."""
    return 1.0 + _ROUNDING * float(np.max(np.diag(scaled), initial=0.0))


def variance_inflation(
    folds: Sequence[Fold],
    information: FloatArray,
    inverse: FloatArray,
    weights: FloatArray,
    groups: Sequence[ParameterGroup],
    least: float = 1.0,
) -> FloatArray:
    """Factors ``(D,)``, not below ``least``, by which errors vary more than under independent residuals.

    The variance is the jackknife's: each fold in turn is left out, and how far the estimate moves shows the effect of
    correlations inside of a fold (Efron 1982). There are only a few folds, so that the ratio to the variance under
    independent residuals is averaged over all directions of a group. Groups differ: noise that changes slowly is taken
    for an offset, and hardly for friction.
    """
    result = np.full(len(weights), least)
    if len(folds) < 2:
        return result
    measured = _sum(folds, len(weights)).information
    moves = np.array([_solved(information - fold.information, weights, fold.gradient) for fold in folds])
    moves = np.sqrt(1.0 - 1.0 / len(folds)) * (moves - np.mean(moves, axis=0))
    independent = inverse @ measured @ inverse
    for group in groups:
        block = independent[np.ix_(group.columns, group.columns)]
        floor = _FLOOR * np.trace(block)
        if floor > 0.0:
            damped = np.linalg.inv(block + floor * np.eye(len(block)))
            seen = moves[:, group.columns]
            result[group.columns] = max(least, float(np.sum((seen @ damped) * seen) / np.sum(damped * block)))
    return result


def prior_spreads(rows: Fold, from_prior: FloatArray, groups: Sequence[ParameterGroup]) -> FloatArray:
    """Standard deviations ``(D,)`` of the prior's errors, one per group, that maximise the marginal likelihood.

    The likelihood is that of ``rows`` with independent errors of standard deviation 1; the prior lies at ``from_prior
    (D,)``. Fixed point of MacKay ("Bayesian interpolation", 1992): the squared distance of the posterior's mean from
    the prior, over the number of directions that the data determine. Where they determine none, the usual spread
    stands.
    """
    usual = np.array([group.usual_spread for group in groups])
    member = np.empty(len(from_prior), dtype=np.int64)
    for index, group in enumerate(groups):
        member[group.columns] = index
    extrapolation, found, begun = Extrapolation(), usual, np.log(usual)
    for _ in range(_ROUNDS):
        # In units of the spreads, in which the prior's part is the identity.
        spreads = np.exp(begun)[member]
        scaled = np.outer(spreads, spreads) * rows.information
        own = _own_part(scaled)
        left = definite.inverse(scaled + own * np.eye(len(spreads)))
        # Not as information times distance, of which rounding would leave little.
        moved = from_prior - spreads * (left @ (own * from_prior / spreads - spreads * rows.gradient))
        determined = np.clip(1.0 - np.diag(left), 0.0, 1.0)
        # The usual spread counts as much as one direction of the tangent space that the data determine.
        squares = np.bincount(member, moved**2, len(groups)) + usual**2
        counts = np.bincount(member, determined, len(groups)) + 1.0
        # Few rows of many parameters can be fitted at any distance.
        found = np.minimum(np.sqrt(squares / counts), _LARGEST_SPREAD * usual)
        begun = extrapolation.next(begun, np.log(found))
    return np.asarray(found[member])


def physical_sensitivity(point: Point) -> FloatArray:
    """Derivative ``(links, 10, 10)`` of each link's quantities (:func:`pseudo_inertia.quantities_of`) by its ten
    tangent coordinates, by central differences along straight lines of the parameters, which begin as geodesics do."""
    parameters = pseudo_inertia.to_parameters(point.pseudo_inertias)[:, None]
    steps = STEP * np.swapaxes(point.links_jacobian, -1, -2)  # one of each coordinate
    ahead, behind = pseudo_inertia.quantities_of(np.stack([parameters + steps, parameters - steps]))
    return np.asarray(np.swapaxes(ahead - behind, -1, -2) / (2.0 * STEP))


def links_information(
    manifold: ParameterManifold,
    prior: Point,
    point: Point,
    measured: tuple[FloatArray, FloatArray],
    known: WeighedRows,
    found: Uncertainty,
) -> LinksInformation:
    """What the rows of an estimate say of the inertias of all links together.

    The effects are eliminated, within their prior, by a QR decomposition in which their columns come first. Data
    without any noise count as if they had a little.

    Args:
        manifold, prior, point: The problem, its prior and the estimate.
        measured: Rows ``(N, D)`` and targets ``(N,)`` of standard deviation 1.
        known: Rows of weighed masses, and of no population.
        found: The uncertainty at the estimate.
    """
    size, first = manifold.dimension, manifold.inertial.stop
    _, diagonal = manifold.jacobian(point)
    of_effects = np.zeros((size - first, size + 1))
    of_effects[:, first:size] = np.diag(1.0 / (diagonal * found.prior_spreads[first:]))
    of_effects[:, size] = -manifold.log(point, prior)[first:] / found.prior_spreads[first:]
    of_data = [
        factor * np.column_stack([rows, rows @ point.parameters - targets])
        for factor, rows, targets in ((np.sqrt(found.share), *measured), (1.0, known.rows, known.targets))
    ]
    stacked = np.concatenate([*of_data, of_effects, np.zeros((first, size + 1))])
    order = [*range(first, size), *range(first), size]
    left = triangular(stacked[:, order])[size - first : size, size - first :]
    whitened = manifold.whiten(point, np.column_stack([left[:, :-1], np.zeros((first, size - first))]))
    left = left / max(1.0, float(np.max(np.abs(whitened), initial=0.0)) / FINEST)
    return LinksInformation(frozen(left[:, :-1]), frozen(left[:, -1]))
