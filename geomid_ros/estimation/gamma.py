"""The weight of the prior by cross-validation on held-out blocks of time."""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.objective import residual_objective
from geomid_ros.estimation.solvers import trust_region
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray

PAPER = 1e-2
# Down to 1e-6: with less, nothing keeps the links that the motion does not excite near what was known of them.
CANDIDATES = tuple(10.0 ** (-0.5 * k) for k in range(2, 13))
_TOLERANCE = 1e-3
_STEPS = 100


def choose_gamma(
    manifold: ParameterManifold, summary: RowSummary, sigmas: FloatArray, prior: Point, known: WeighedRows
) -> float:
    """The candidate with the least of :func:`held_out_losses`; the paper's where nothing can be held out."""
    losses = held_out_losses(manifold, summary, sigmas, prior, known)
    return min(losses, key=lambda gamma: losses[gamma]) if losses else PAPER


def held_out_losses(
    manifold: ParameterManifold, summary: RowSummary, sigmas: FloatArray, prior: Point, known: WeighedRows
) -> dict[float, float]:
    """Loss on held-out folds by weight of the prior, a share of the sum of the rows' weights; empty without two folds.

    Each fold is judged by the fit to the others and to the ``known`` rows, with the channels' standard deviations
    ``sigmas (channels,)``. The loss is the logarithm of the mean squared error, averaged over channels and folds: the
    likelihood when no error is taken to be of a known size, so that a violent passage or a badly modelled channel has
    one voice like the others. Fits go from strong to weak priors, each from where the last one ended. All are tried:
    the loss may rise before it falls.
    """
    folds = [fold for fold in range(summary.folds) if np.any(np.isfinite(summary.rms(prior.parameters, [fold])))]
    if len(folds) < 2:
        return {}
    training = [summary.compressed(sigmas, manifold.dimension, [f for f in folds if f != fold]) for fold in folds]
    points = [prior] * len(folds)
    losses: dict[float, float] = {}
    for gamma in CANDIDATES:
        loss = []
        for place, (fold, measured) in enumerate(zip(folds, training, strict=True)):
            objective = residual_objective(manifold, measured, known, prior, gamma)
            points[place] = trust_region(objective, points[place], _TOLERANCE * objective.gamma, _STEPS).point
            error = summary.rms(points[place].parameters, [fold])
            loss.append(2.0 * np.log(np.maximum(error, np.finfo(float).tiny)))
        losses[gamma] = float(np.nanmean(loss))
    return losses
