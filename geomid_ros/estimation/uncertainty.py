"""How sure an estimate is: the covariance of its error in the tangent space, and what of it the data made surer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray, IntArray

# What is usual counts as much for a spread as one direction of the tangent space that the data determine.
_CERTAINTY_OF_USUAL = 1.0
_ROUNDS = 30  # of the fixed point; a fixed number, so that rounding cannot change how many there are
_LARGEST_SPREAD = 100.0  # times the usual
_ROUNDING = float(np.finfo(float).eps)  # of the largest information: what rounding may make of none
_STEP = 1e-5
# Directions of so little variance are not told apart: a share of all of the variance there is.
_FLOOR = 1e-4


@dataclass(frozen=True, eq=False)
class Fold:
    """A block of time at the estimate: half the ``gradient (D,)`` of its rows' squared residuals, and their
    ``information (D, D)``, in tangent coordinates."""

    gradient: FloatArray
    information: FloatArray


@dataclass(frozen=True, eq=False)
class Kind:
    """Tangent coordinates ``columns`` whose priors are equally sure, and the ``usual_spread`` of the priors' errors."""

    columns: IntArray
    usual_spread: float


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """At an estimate: ``covariance (D, D)`` of its error in tangent coordinates, and the standard deviations
    ``prior_spreads (D,)`` of the prior's. ``share``: what correlations leave of the measured rows' information, 0 to
    1."""

    covariance: FloatArray
    prior_spreads: FloatArray
    share: float

    def from_data(self, columns: slice) -> float:
        """The share of the prior's variance in these coordinates that the data took away, 0 to 1.

        Per principal direction, and on average. Where the prior has the weight that its spread deserves, this is the
        trace of the resolution matrix over its size.
        """
        spreads = self.prior_spreads[columns]
        left = np.linalg.eigvalsh(self.covariance[columns, columns] / np.outer(spreads, spreads))
        return float(np.mean(np.clip(1.0 - left, 0.0, 1.0)))


def uncertainty(
    folds: Sequence[Fold],
    known: Fold,
    trust: float,
    prior_weights: FloatArray,
    from_prior: FloatArray,
    kinds: Sequence[Kind],
) -> Uncertainty:
    """Uncertainty of a regularised estimate.

    ``folds`` are the measured rows by blocks of time. ``known`` are rows whose errors are independent and of the known
    size, which the objective weighted by ``trust``. ``prior_weights (D,)`` are the factors of the squared distance to
    the prior, ``from_prior (D,)`` the tangent coordinates of the prior at the estimate. ``kinds`` share out all
    coordinates. Per kind two numbers are read off the data: the factor by which residuals that are correlated make
    errors larger than independent ones would (:func:`inflations`), and the size of the prior's errors
    (:func:`prior_spreads`).
    """
    weights = np.maximum(prior_weights, np.finfo(float).tiny)
    measured = _sum(folds, len(weights))
    factors = inflations(folds, trust * known.information, weights, kinds)
    share = 1.0 / float(np.mean(factors))
    independent = Fold(share * measured.gradient + known.gradient, share * measured.information + known.information)
    spreads = prior_spreads(independent, from_prior, kinds)
    return Uncertainty(
        error_covariance(measured.information, known.information, trust, weights, factors, spreads), spreads, share
    )


def _sum(folds: Sequence[Fold], dimension: int) -> Fold:
    gradient, information = np.zeros(dimension), np.zeros((dimension, dimension))
    for fold in folds:
        gradient += fold.gradient
        information += fold.information
    return Fold(gradient, information)


def error_covariance(
    measured: FloatArray,
    known: FloatArray,
    trust: float,
    weights: FloatArray,
    factors: FloatArray,
    spreads: FloatArray,
) -> FloatArray:
    """Covariance ``(D, D)`` of the estimate's error ``H^-1 (noise + W error of the prior)``.

    H is the sum of the ``measured`` information, of the ``known`` times ``trust``, and of the prior's ``weights`` W.
    Measured rows' noise has the covariance ``measured``, enlarged by ``factors``; the prior's error has standard
    deviations ``spreads``. With ``W = 1 / spreads^2``, and all factors and trust 1, this is ``H^-1``, the Bayesian
    posterior.
    """
    inverse = _inverse(measured + trust * known, weights)
    parts = (
        np.sqrt(factors)[:, None] * (inverse @ _root(measured)),
        trust * (inverse @ _root(known)),
        inverse * (weights * spreads),
    )
    result: FloatArray = np.sum([part @ part.T for part in parts], axis=0)
    return result


def _root(information: FloatArray) -> FloatArray:
    """A matrix whose square, it times its transpose, this is; what rounding made negative is zero."""
    values, vectors = np.linalg.eigh(information)
    result: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
    return result


def _inverse(information: FloatArray, weights: FloatArray) -> FloatArray:
    """``(information + W)^-1`` for any weights above zero: rounding cannot make it indefinite."""
    units = np.sqrt(weights)
    values, vectors = np.linalg.eigh(information / np.outer(units, units))
    vectors = vectors / units[:, None]
    result: FloatArray = (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T
    return result


def inflations(folds: Sequence[Fold], known: FloatArray, weights: FloatArray, kinds: Sequence[Kind]) -> FloatArray:
    """By how much ``(D,)`` the noise makes errors' variances larger than independent residuals would, at least 1.

    The variance that is there is the jackknife's: each fold in turn is left out, and how far the estimate moves shows
    what the correlations inside of a fold do (Efron 1982). There are only a few folds, so that the ratio to the
    variance of independent residuals is averaged over all directions of a kind. Kinds differ: noise that changes slowly
    is taken for an offset, and hardly for friction.
    """
    result = np.ones(len(weights))
    if len(folds) < 2:
        return result
    measured = _sum(folds, len(weights)).information
    total = measured + known
    moves = np.array([_inverse(total - fold.information, weights) @ fold.gradient for fold in folds])
    moves = np.sqrt(1.0 - 1.0 / len(folds)) * (moves - np.mean(moves, axis=0))
    inverse = _inverse(total, weights)
    independent = inverse @ measured @ inverse
    for kind in kinds:
        block = independent[np.ix_(kind.columns, kind.columns)]
        floor = _FLOOR * np.trace(block)
        if floor > 0.0:
            damped = np.linalg.inv(block + floor * np.eye(len(block)))
            seen = moves[:, kind.columns]
            result[kind.columns] = max(1.0, float(np.sum((seen @ damped) * seen) / np.sum(damped * block)))
    return result


def prior_spreads(rows: Fold, from_prior: FloatArray, kinds: Sequence[Kind]) -> FloatArray:
    """Standard deviations ``(D,)`` of the prior's errors, one per kind, of the greatest marginal likelihood.

    The likelihood is that of ``rows`` with independent errors of standard deviation 1; the prior lies at ``from_prior
    (D,)``. Fixed point of MacKay ("Bayesian interpolation", 1992): the squared distance of the posterior's mean from
    the prior, over the number of directions that the data determine. Where they determine none, the usual spread
    stands.
    """
    spreads = np.empty(len(from_prior))
    for kind in kinds:
        spreads[kind.columns] = kind.usual_spread
    pull = rows.information @ from_prior + rows.gradient
    for _ in range(_ROUNDS):
        # In units of the spreads, in which the prior's part is the identity.
        scaled = np.outer(spreads, spreads) * rows.information
        least = 1.0 + _ROUNDING * float(np.max(np.diag(scaled), initial=0.0))
        left = np.linalg.inv(scaled + least * np.eye(len(spreads)))
        moved = spreads * (left @ (spreads * pull))
        determined = np.clip(1.0 - np.diag(left), 0.0, 1.0)
        for kind in kinds:
            squares = float(np.sum(moved[kind.columns] ** 2)) + _CERTAINTY_OF_USUAL * kind.usual_spread**2
            count = float(np.sum(determined[kind.columns])) + _CERTAINTY_OF_USUAL
            most = _LARGEST_SPREAD * kind.usual_spread  # few rows of many parameters can be fitted at any distance
            spreads[kind.columns] = min(float(np.sqrt(squares / count)), most)
    return spreads


def physical_sensitivity(manifold: ParameterManifold, point: Point) -> FloatArray:
    """Derivative ``(links, 10, 10)`` of each link's mass, centre of mass and central inertia (xx xy yy xz yz zz) by its
    ten tangent coordinates, by central differences along geodesics."""
    derivative = np.empty((manifold.links, 10, 10))
    for k in range(10):
        tangent = np.zeros(manifold.dimension)
        tangent[k : manifold.inertial.stop : 10] = _STEP
        ends = np.array([manifold.exp(point, sign * tangent).pseudo_inertias for sign in (1.0, -1.0)])
        ahead, behind = pseudo_inertia.quantities_of(pseudo_inertia.to_parameters(ends))
        derivative[:, :, k] = (ahead - behind) / (2.0 * _STEP)
    return derivative
