"""Uncertainty of an estimate: the covariance of its error in the tangent space, and the contribution of the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.estimate import FINEST, LinksInformation, quantities_and_moments
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.solvers import Extrapolation, trust_region
from geomid_ros.estimation.tolerances import LEAST_DECREASE
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.dynamics import STEP
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray, frozen

_ROUNDS = 10  # of the fixed point; a fixed number, so that rounding cannot change it
_FOLDS_OF_BLOCKS = (1, 2, 4)
"""Block lengths, in folds; the largest inflation counts, because correlations longer than a block are hidden in it."""
_DOUBT = 3.0  # factor of the prior's errors with which a quantity must still be identified, by the data alone
_ROUNDING = float(np.finfo(float).eps)  # times the largest information: what rounding may make of zero
_POSITIVE = (0, 4, 6, 9)  # numbers of a body whose intervals are those of their logarithms: mass and moments of inertia
_PAIRS = 16  # of opposite errors: a standard deviation is then known to a fifth
# Fraction of the total variance: directions of less variance are not distinguished.
_FLOOR = 1e-4


@dataclass(frozen=True, eq=False)
class Fold:
    """Block of time at the estimate: half the ``gradient (D,)`` of its rows' squared residuals, and their
    ``information (D, D)``, in tangent coordinates."""

    gradient: FloatArray
    information: FloatArray

    @cached_property
    def root(self) -> FloatArray:
        """Matrix that times its transpose is the information; eigenvalues that rounding made negative are zero."""
        values, vectors = np.linalg.eigh(self.information)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, eq=False)
class Folds:
    """All measured rows by blocks of time, ``parts``, in their order; at least one."""

    parts: Sequence[Fold]

    @cached_property
    def total(self) -> Fold:
        """All rows."""
        return _sum(self.parts)

    @cached_property
    def blocks(self) -> list[list[Fold]]:
        """The rows by blocks of each of the :data:`_FOLDS_OF_BLOCKS`."""
        return [
            [_sum(self.parts[first : first + count]) for first in range(0, len(self.parts), count)]
            for count in _FOLDS_OF_BLOCKS
        ]


def fold_at(manifold: ParameterManifold, point: Point, products: FloatArray) -> Fold:
    """Build a fold from the ``products (D + 1, D + 1)`` of the columns ``[A b]`` of rows of standard deviation 1."""
    slope = products[:-1] @ np.append(point.parameters, -1.0)
    half = manifold.whiten(point, products[:-1, :-1])
    return Fold(manifold.whiten(point, slope[None])[0], manifold.whiten(point, half.T))


@dataclass(frozen=True, eq=False)
class ParameterGroup:
    """Tangent coordinates ``columns`` that share one prior std, by default ``default_prior_std``."""

    columns: IntArray
    default_prior_std: float


@dataclass(frozen=True, eq=False)
class GridSteps:
    """By how much the rows at an estimate would change if an effect had the next constant of its grid.

    Attributes:
        columns: Tangent coordinate ``(k,)`` of each effect's coefficient.
        products: Products ``(k, D)`` of the changes with the rows' derivatives by the tangent coordinates.
        squares: Squared norms ``(k,)`` of the changes.
    """

    columns: IntArray
    products: FloatArray
    squares: FloatArray


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty at an estimate, in tangent coordinates.

    Attributes:
        covariance: ``(D, D)`` of the estimate's error.
        covariance_from_prior: The part of it that the prior's error causes.
        prior: Covariance ``(D, D)`` of the prior's error.
        independent_fraction: Fraction of the measured rows' information that correlations leave, 0 to 1.
        by_rows: Information ``(D,)`` of the rows on each coordinate, with the others free within their priors.
        response: Shift ``(D, D)`` of the estimate by a gradient of its objective: the inverse Hessian.
        own_constant: The part ``(D,)`` of the variances that the constant of a coefficient's own effect causes.
    """

    covariance: FloatArray
    covariance_from_prior: FloatArray
    prior: FloatArray
    independent_fraction: float
    by_rows: FloatArray
    response: FloatArray
    own_constant: FloatArray | float = 0.0

    @property
    def prior_stds(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error."""
        return np.asarray(np.sqrt(np.diag(self.prior)))

    def from_data(self, columns: slice) -> float:
        """Fraction of the prior variance in these coordinates that the data removed, 0 to 1.

        Computed per principal direction, then averaged. If the prior's weight matches its standard deviation, this is
        the trace of the resolution matrix over its size.
        """
        root = np.linalg.inv(np.linalg.cholesky(self.prior[columns, columns]))
        remaining = np.linalg.eigvalsh(root @ self.covariance[columns, columns] @ root.T)
        return float(np.mean(np.clip(1.0 - remaining, 0.0, 1.0)))

    def with_unknown_constants(self, steps: GridSteps) -> Uncertainty:
        """Return it with the errors of constants that were chosen from grids.

        To first order a constant that is off by ``d`` steps of its grid shifts the estimate as ``d`` times the change
        of the rows does. Its variance, in steps, is that of rounding to the grid, 1 / 12, and that of the choice: a
        prior std of one step, and what the change has beyond all that other parameters can follow.
        """
        moves = steps.products @ self.response
        told = self.independent_fraction * (steps.squares - np.sum(moves * steps.products, axis=1))
        variances = 1.0 / 12.0 + 1.0 / (1.0 + np.maximum(told, 0.0))
        own = np.zeros(len(self.covariance))
        own[steps.columns] = variances * moves[np.arange(len(moves)), steps.columns] ** 2
        return replace(self, covariance=self.covariance + (moves.T * variances) @ moves, own_constant=own)

    def with_unknown_scale(self, shift: FloatArray) -> Uncertainty:
        """Return it with the error of a common scale that the rows do not tell: a ``shift (D,)`` of the estimate by one
        standard deviation of it."""
        return replace(self, covariance=self.covariance + np.outer(shift, shift))


def estimate_uncertainty(
    folds: Folds,
    known: Fold,
    trust: float,
    prior_weights: FloatArray,
    from_prior: FloatArray,
    groups: Sequence[ParameterGroup],
    *,
    least_inflation: float = 1.0,
    assumed_prior_stds: FloatArray | float = 0.0,
    expected: FloatArray | float = 0.0,
) -> Uncertainty:
    """Uncertainty of a regularised estimate.

    Two numbers per group are estimated from the data: the factor by which correlated residuals enlarge the errors
    (:func:`variance_inflation`), and the standard deviation of the prior's errors (:func:`estimated_prior_stds`). A few
    blocks of time and a few links determine both only roughly, so each is bounded below by what is known otherwise.

    Args:
        folds: The measured rows.
        known: Rows whose errors are independent and of known size.
        trust: Weight of the known rows in the objective.
        prior_weights: Factors ``(D,)`` of the squared distance to the prior.
        from_prior: Tangent coordinates ``(D,)`` of the prior at the estimate.
        groups: A partition of all coordinates.
        least_inflation: Least inflation factor: what the filter of the rows is known to cause.
        assumed_prior_stds: Standard deviations ``(D,)`` of the prior's error that the estimate assumed; a lower bound.
        expected: Information ``(D, D)`` of those known rows that belong to the prior.
    """
    weights = np.maximum(prior_weights, np.finfo(float).tiny)
    measured = folds.total
    information = measured.information + trust * known.information
    inverse = information_inverse(information, weights)
    independent = inverse @ measured.information @ inverse
    inflations = [
        variance_inflation(block, information, independent, weights, groups, least_inflation) for block in folds.blocks
    ]
    factors = np.max(inflations, axis=0)
    share = 1.0 / float(np.mean(factors))
    rows = Fold(share * measured.gradient + known.gradient, share * measured.information + known.information)
    stds = np.maximum(estimated_prior_stds(rows, from_prior, groups), assumed_prior_stds)
    noise, inherited = error_covariance(inverse, measured.root, trust, known.root, factors, weights * stds)
    covariance = noise + inherited
    prior = information_inverse(np.zeros_like(covariance) + expected, stds**-2.0)
    by_rows = np.maximum(1.0 / np.diag(inverse) - weights, 0.0) / factors
    return Uncertainty(covariance, inherited, prior, share, by_rows, inverse)


def _sum(folds: Sequence[Fold]) -> Fold:
    first, *others = folds
    if not others:
        return first
    gradient, information = first.gradient.copy(), first.information.copy()
    for fold in others:
        gradient += fold.gradient
        information += fold.information
    return Fold(gradient, information)


def error_covariance(
    inverse: FloatArray, measured: FloatArray, trust: float, known: FloatArray, factors: FloatArray, pulls: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance ``(D, D)`` of the estimate's error ``H^-1 (noise + W error of the prior)``: rows' and prior's part.

    With ``W = 1 / stds^2``, and all factors and trust 1, they add up to ``H^-1``, the Bayesian posterior.

    Args:
        inverse: ``(D, D)`` of H, which is ``measured + trust known + W``.
        measured, known: Roots ``(D, n)`` of the rows' information, which times their transpose are it. The noise of the
            measured rows has their information as covariance, enlarged by ``factors``.
        trust: Weight of the known rows.
        factors: Variance inflation ``(D,)``.
        pulls: Standard deviations ``(D,)`` of the prior's error, times the prior's weights, the diagonal of W.
    """
    row_root = np.sqrt(factors)[:, None] * (inverse @ measured)
    known_root = trust * (inverse @ known)
    prior_root = inverse * pulls
    return row_root @ row_root.T + known_root @ known_root.T, prior_root @ prior_root.T


def with_enlarged_prior(covariance: FloatArray, inherited: FloatArray) -> FloatArray:
    """Covariance ``(D, D)`` of an estimate's error if the prior's errors were three times as large; ``inherited``:
    their part of ``covariance``. A quantity that is known even then is known from the data."""
    return covariance + (_DOUBT**2 - 1.0) * inherited


def information_inverse(information: FloatArray, weights: FloatArray) -> FloatArray:
    """``(information + W)^-1`` for any weights above zero: rounding cannot make it indefinite."""
    root = information_inverse_root(information, weights)
    return np.asarray(root @ root.T)


def information_inverse_root(information: FloatArray, weights: FloatArray) -> FloatArray:
    """A matrix R ``(D, D)`` with ``R R^T = (information + W)^-1``: ``|R^T x|`` is the standard deviation of x."""
    units = np.sqrt(weights)
    values, vectors = np.linalg.eigh(information / np.outer(units, units))
    return np.asarray(vectors / units[:, None] / np.sqrt(1.0 + np.maximum(values, 0.0)))


def _prior_part(scaled: FloatArray) -> float:
    """Prior's part of each diagonal entry of an information matrix in units of the prior std: one, plus what rounding
    may have taken from the information."""
    return 1.0 + _ROUNDING * float(np.max(np.diag(scaled), initial=0.0))


def variance_inflation(
    folds: Sequence[Fold],
    information: FloatArray,
    independent: FloatArray,
    weights: FloatArray,
    groups: Sequence[ParameterGroup],
    least: float = 1.0,
) -> FloatArray:
    """Factors ``(D,)``, at least ``least``, by which error variances exceed those for independent residuals.

    The variance is the jackknife's: each fold in turn is left out, and how far the estimate moves shows the effect of
    correlations inside a fold (Efron 1982). There are only a few folds, so the ratio to the variance for independent
    residuals is averaged over all directions of a group. Groups differ: slowly changing noise is mistaken for an
    offset, but hardly for friction. ``independent (D, D)``: covariance of the error for independent residuals.
    """
    result = np.full(len(weights), least)
    if len(folds) < 2:
        return result
    prior_stds, moves = weights**-0.5, []
    units = np.outer(prior_stds, prior_stds)
    for fold in folds:
        scaled = (information - fold.information) * units
        np.fill_diagonal(scaled, np.diag(scaled) + _prior_part(scaled))
        moves.append(prior_stds * spd.solve_or_least_squares(scaled, prior_stds * fold.gradient))
    shifts = np.sqrt(1.0 - 1.0 / len(folds)) * (moves - np.mean(moves, axis=0))
    for group in groups:
        block = independent[np.ix_(group.columns, group.columns)]
        floor = _FLOOR * np.trace(block)
        if floor > 0.0:
            damped = np.linalg.inv(block + floor * np.eye(len(block)))
            moved = shifts[:, group.columns]
            result[group.columns] = max(least, float(np.sum((moved @ damped) * moved) / np.sum(damped * block)))
    return result


def estimated_prior_stds(rows: Fold, from_prior: FloatArray, groups: Sequence[ParameterGroup]) -> FloatArray:
    """Standard deviations ``(D,)`` of the prior's errors, one per group, that maximise the marginal likelihood.

    The likelihood is that of ``rows`` with independent errors of standard deviation 1; the prior lies at
    ``from_prior (D,)``. MacKay's fixed point ("Bayesian interpolation", 1992) is the squared distance of the
    posterior's mean from the prior, over the number of directions that the data determine. If they determine none, the
    default stays.
    """
    usual = np.array([group.default_prior_std for group in groups])
    member = np.empty(len(from_prior), dtype=np.int64)
    for index, group in enumerate(groups):
        member[group.columns] = index
    extrapolation, stds, log_stds = Extrapolation(), usual, np.log(usual)
    for _ in range(_ROUNDS):
        # In units of the prior std, in which the prior's part is the identity.
        parameter_stds = np.exp(log_stds)[member]
        scaled = np.outer(parameter_stds, parameter_stds) * rows.information
        prior_part = _prior_part(scaled)
        root = spd.roots(scaled + prior_part * np.eye(len(parameter_stds)), len(parameter_stds))
        # Not as information times distance, of which rounding would leave little.
        moved = from_prior - parameter_stds * (
            root @ ((prior_part * from_prior / parameter_stds - parameter_stds * rows.gradient) @ root)
        )
        determined = np.clip(1.0 - np.sum(root**2, axis=1), 0.0, 1.0)
        # The default prior std counts as much as one direction that the data determine.
        squares = np.bincount(member, moved**2, len(groups)) + usual**2
        counts = np.bincount(member, determined, len(groups)) + 1.0
        # A few rows of many parameters can be fitted at any distance from the prior.
        stds = np.minimum(np.sqrt(squares / counts), FINEST * usual)
        log_stds = extrapolation.next(log_stds, np.log(stds))
    return np.asarray(stds[member])


def physical_sensitivity(point: Point) -> FloatArray:
    """Derivative ``(links, 10, 10)`` of each link's quantities (:func:`pseudo_inertia.quantities_of`) by its ten
    tangent coordinates. Central differences along straight lines of the parameters, which begin as geodesics do."""
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
    """Log-likelihood of the inertias of all links together, from the rows of an estimate.

    The effects are eliminated, within their prior, by a QR decomposition in which their columns come first. Data
    without noise count as if they had a little.

    Args:
        manifold, prior, point: The problem's manifold, its prior and the estimate.
        measured: Rows ``(N, D)`` and targets ``(N,)`` of standard deviation 1.
        known: Rows of weighed masses, without those of a population.
        found: The uncertainty at the estimate.
    """
    size, first = manifold.dimension, manifold.inertial.stop
    _, diagonal = manifold.jacobian(point)
    effect_rows = np.zeros((size - first, size + 1))
    effect_rows[:, first:size] = np.diag(1.0 / (diagonal * found.prior_stds[first:]))
    effect_rows[:, size] = -manifold.log(point, prior)[first:] / found.prior_stds[first:]
    data_rows = [
        factor * np.column_stack([rows, rows @ point.parameters - targets])
        for factor, rows, targets in (
            (np.sqrt(found.independent_fraction), *measured),
            (1.0, known.rows, known.targets),
        )
    ]
    stacked = np.concatenate([*data_rows, effect_rows, np.zeros((first, size + 1))])
    order = [*range(first, size), *range(first), size]
    link_rows = triangular(stacked[:, order])[size - first : size, size - first :]
    whitened = manifold.whiten(point, np.column_stack([link_rows[:, :-1], np.zeros((first, size - first))]))
    link_rows = link_rows / max(1.0, float(np.max(np.abs(whitened), initial=0.0)) / FINEST)
    return LinksInformation(frozen(link_rows[:, :-1]), frozen(link_rows[:, -1]))


def stds_along_geodesics(
    prior: Point, point: Point, information: LinksInformation, prior_stds: FloatArray
) -> FloatArray:
    """Standard deviations ``(links, 13)`` of the quantities and first moments of all links, by randomised minima.

    If the prior's errors are large, a covariance at the estimate is far too small: the nearest bodies to a small one,
    among those with a given first moment, are thin, and a thin body cannot change its mass along straight lines. So the
    errors of the rows and of the prior, along geodesics, are drawn, and the estimate is computed anew for each
    ("randomize-then-optimize"; Bardsley et al., SIAM J. Sci. Comput., 2014). For small errors the result is the same.

    Args:
        prior, point: the links' prior and estimate.
        information: Log-likelihood of the links.
        prior_stds: Standard deviations ``(10 links,)`` of the prior's error.
    """
    size = len(prior_stds)
    manifold = ParameterManifold(size // spd.SIZE, 0, np.zeros(0))
    # Triangular factors of nearly the same rows may differ; symmetric ones do not, and nor do the errors of their rows.
    left, sizes, right = np.linalg.svd(information.rows)
    rows = (right.T * sizes) @ right
    targets = rows @ point.parameters - right.T @ (left.T @ information.residuals)
    estimated = quantities_and_moments(pseudo_inertia.to_parameters(point.pseudo_inertias))
    errors = np.random.default_rng(0).standard_normal((_PAIRS, 2, size))
    off = []
    for of_prior, of_rows in np.concatenate([errors, -errors]):
        augmented = np.column_stack([rows, targets + of_rows])
        drawn = (prior_stds * of_prior).reshape(-1, spd.SIZE)
        farthest = np.log(FINEST)  # rounding allows no more
        drawn /= np.maximum(np.linalg.norm(drawn, axis=1, keepdims=True) / farthest, 1.0)
        moved = manifold.exp(prior, drawn.ravel())
        objective = ResidualObjective(manifold, augmented.T @ augmented, moved, prior_stds**-2.0, float(size))
        search = partial(trust_region, objective, least_decrease=LEAST_DECREASE)
        try:
            minimum = search(point).point
        except LinAlgError:  # the drawn prior is too far away for finite numbers
            minimum = search(moved).point
        numbers = quantities_and_moments(pseudo_inertia.to_parameters(minimum.pseudo_inertias))
        off.append(numbers - estimated)
        off[-1][:, _POSITIVE] = estimated[:, _POSITIVE] * np.log(numbers[:, _POSITIVE] / estimated[:, _POSITIVE])
    return np.asarray(np.sqrt(0.5 * np.pi) * np.mean(np.abs(off), axis=0))
