"""The weight of the prior by cross-validation on held-out blocks of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.objective import residual_objective
from geomid_ros.estimation.solvers import trust_region
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.known import KnownRows
from geomid_ros.types import FloatArray

PAPER = 1e-2
# Down to 1e-6: with less, nothing keeps the links that the motion does not excite near what was known of them.
CANDIDATES = tuple(10.0 ** (-0.5 * k) for k in range(2, 13))
_TOLERANCE = 1e-3
_STEPS = 100


@dataclass(frozen=True)
class GammaChoice:
    """The chosen weight, as a share of the sum of the rows' weights, and the held-out loss of each one tried."""

    gamma: float
    losses: dict[float, float]


def choose_gamma(
    manifold: ParameterManifold, summary: RowSummary, sigmas: FloatArray, prior: Point, known: KnownRows
) -> GammaChoice:
    """The prior's weight that predicts folds which were not fitted best.

    Each fold is judged by the fit to the others, with ``sigmas (channels,)``, and to what is ``known``. The loss is the
    logarithm of the mean squared error, averaged over channels and folds: the likelihood when no error is taken to be
    of a known size, so that a violent passage or a badly modelled channel has one voice like the others. Fits go from
    strong to weak priors, each from where the last one ended. All are tried: the loss may rise before it falls.
    """
    folds = [fold for fold in range(summary.folds) if np.any(np.isfinite(summary.rms(prior.parameters, [fold])))]
    if len(folds) < 2:
        return GammaChoice(PAPER, {})
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
    return GammaChoice(min(losses, key=lambda gamma: losses[gamma]), losses)
