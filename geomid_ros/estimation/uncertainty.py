"""How sure an estimate is: covariance in the tangent space, and which share of it came from the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

# The prior is never taken to be surer than this (a relative error per direction of the tangent space).
LEAST_PRIOR_SPREAD = 0.1
_STEP = 1e-5
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """At an estimate: ``covariance (D, D)`` in tangent coordinates, ``resolution (D, D)`` (share of each direction that
    the data determined; its trace over a link's ten, over ten, is the link's) and the ``prior_spread`` assumed."""

    covariance: FloatArray
    resolution: FloatArray
    prior_spread: float


def uncertainty(
    information: FloatArray, prior_weight: float, fold_gradients: Sequence[FloatArray], from_prior: FloatArray
) -> Uncertainty:
    """Uncertainty of a regularised estimate.

    ``information (D, D)`` is that of the rows, ``prior_weight`` the factor of the squared distance to the prior,
    ``from_prior (D,)`` the tangent coordinates of the prior at the estimate. With H their sum, the estimate's error is
    ``H^-1 (noise + prior_weight * error of the prior)``:

    - The noise has the covariance ``k information``. The factor k is 1 for independent residuals of the right size;
      correlated residuals make it larger. It is read off how much the folds' gradients ``(D,)`` scatter.
    - The prior's error is taken as equally large in all directions, with the spread seen where the data could tell.
    """
    values, vectors = np.linalg.eigh(information)
    values = np.where(values > _ROUNDING * values[-1], values, 0.0)
    prior_weight = max(prior_weight, float(np.finfo(float).tiny))
    shares = values / (values + prior_weight)
    told = float(np.sum(shares))
    spread = float(np.sqrt(np.sum(shares * (vectors.T @ from_prior) ** 2) / told)) if told > 0.0 else 0.0
    spread = max(spread, LEAST_PRIOR_SPREAD)
    noise = _inflation(values, vectors, prior_weight, fold_gradients) * shares / (values + prior_weight)
    variances = noise + ((1.0 - shares) * spread) ** 2
    return Uncertainty((vectors * variances) @ vectors.T, (vectors * shares) @ vectors.T, spread)


def _inflation(
    values: FloatArray, vectors: FloatArray, prior_weight: float, fold_gradients: Sequence[FloatArray]
) -> float:
    """Factor by which the folds' gradients scatter more than independent residuals would let them, at least 1."""
    folds = len(fold_gradients)
    told = values > prior_weight
    if folds < 2 or not np.any(told):
        return 1.0
    components = (np.array(fold_gradients) @ vectors[:, told]) / np.sqrt(values[told])
    scatter = float(np.sum((components - components.mean(axis=0)) ** 2)) / np.count_nonzero(told)
    return max(1.0, scatter * folds / (folds - 1))


def physical_sensitivity(manifold: ParameterManifold, point: Point) -> FloatArray:
    """Derivative ``(links, 10, 10)`` of each link's mass, centre of mass and central inertia (xx xy yy xz yz zz) by its
    ten tangent coordinates, by central differences along geodesics."""
    derivative = np.empty((manifold.links, 10, 10))
    for k in range(10):
        tangent = np.zeros(manifold.dimension)
        tangent[k : manifold.inertial.stop : 10] = _STEP
        ahead, behind = (physical_values(manifold.exp(point, sign * tangent)) for sign in (1.0, -1.0))
        derivative[:, :, k] = (ahead - behind) / (2.0 * _STEP)
    return derivative


def physical_values(point: Point) -> FloatArray:
    """Mass, centre of mass and central inertia (xx xy yy xz yz zz) of each link, ``(links, 10)``."""
    parameters = pseudo_inertia.to_parameters(point.pseudo_inertias)
    central = pseudo_inertia.central_inertia(parameters)
    rows, columns = pseudo_inertia.INERTIA_ENTRIES
    return np.concatenate(
        [parameters[:, :1], pseudo_inertia.centre_of_mass(parameters), central[:, rows, columns]], axis=1
    )
