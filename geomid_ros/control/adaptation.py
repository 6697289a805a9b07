"""Natural adaptation: the inertia of one body follows what the controller's feedback has to add.

Lee, Kwon and Park (2018), "A natural adaptive control law for robot manipulators", move the pseudo-inertia P down the
gradient ``Y^T s`` of the tracking error in the metric ``tr(P^-1 X P^-1 Y)``, so that the body stays possible. Here

- the feedback ``K s`` is read from measured efforts: neither gains nor the clock of the controller are needed. The
  correction that is under way is taken off, as in a Smith predictor: ``r = effort - Y p`` is left, whatever the delay;
- a step is the shortest that explains a share of r at all joints at once, within their noise: with rows A and r in
  units of the noise, and A whitened at P, it is ``share A^T (A A^T + 1)^-1 r``. The loop's gain is ``share`` a step,
  in every direction that efforts show, and less in others;
- it follows the geodesic ``P^1/2 exp(X) P^1/2``, which stays in the cone however long it is.
"""

from __future__ import annotations

import math

import numpy as np

from geomid_ros.estimation.tolerances import LARGEST_STEP
from geomid_ros.geometry import definite, spd, symmetric
from geomid_ros.geometry.manifold import ONE_BODY, Point
from geomid_ros.geometry.pseudo_inertia import to_parameters
from geomid_ros.types import FloatArray

MARGIN = 0.5
"""Gain times delay: an integrator behind a delay has 61 degrees of phase left, and is unstable at pi / 2."""
SHORTEST = 0.01
"""Shortest delay that the gain is set for [s]: a faster loop follows friction that the model lacks."""
FARTHEST = 0.3
"""Physical limit: a payload's centre of mass lies no farther from the origin of the link that carries it [m]."""


def share_of(step: float, delay: float) -> float:
    """Share of the residual that a step of so many seconds takes away, at the gain ``MARGIN / delay`` [1/s]."""
    return -math.expm1(-MARGIN * step / max(delay, SHORTEST))


def needed(point: Point, rows: FloatArray, residuals: FloatArray) -> FloatArray:
    """Shortest tangent vector ``(10,)`` that explains ``residuals (joints,)`` by ``rows (joints, 10)``, both in units
    of the residuals' noise."""
    whitened = ONE_BODY.whiten(point, rows)
    weights = definite.solved_anyway(whitened @ whitened.T + np.eye(len(rows)), residuals)
    return np.asarray(weights @ whitened)


def divergence(point: Point, reference: Point) -> float:
    """Bregman divergence ``tr(P_0^-1 P) - log det(P_0^-1 P) - 4`` of the log-determinant, from the ``reference``."""
    values = np.linalg.eigvalsh(spd.congruence(reference.inverse_root, point.pseudo_inertias))
    return float(np.sum(values - np.log(values) - 1.0))


class Adaptation:
    """The inertia of a body, as far from the identified one as a payload may bring it."""

    def __init__(self, identified: FloatArray, heaviest: float) -> None:
        """
        Args:
            identified: inertia ``(10,)`` of the body by the model.
            heaviest: payload [kg].
        """
        self._identified = ONE_BODY.point(identified)
        corners = FARTHEST * np.concatenate([np.eye(3), -np.eye(3)])
        ends = np.append(corners, np.ones((6, 1)), axis=1)
        loads = to_parameters(heaviest * ends[:, :, None] * ends[:, None, :])
        self._bound = max(divergence(ONE_BODY.point(identified + load), self._identified) for load in loads)
        self._spread = np.mean(loads, axis=0)
        self.point = self._identified

    @property
    def change(self) -> FloatArray:
        """Difference ``(10,)`` to the identified inertia."""
        return self.point.parameters - self._identified.parameters

    def step(self, tangent: FloatArray) -> None:
        """Go along a ``tangent (10,)``, no farther than rows are nearly linear, unless it leads beyond the bound."""
        length = float(np.linalg.norm(tangent))
        end = ONE_BODY.exp(self.point, tangent * min(1.0, LARGEST_STEP / length) if length else tangent)
        reached = divergence(end, self._identified)
        if reached < self._bound or reached < divergence(self.point, self._identified):
            self.point = end

    def explains(self, rows: FloatArray, residuals: FloatArray) -> bool:
        """True if the body with a payload may leave the ``residuals`` of :func:`needed`.

        The shortest change that explains them is sought in the metric of the body with the heaviest payload, spread as
        far as it may lie. It must not take away more than this whole: a contact that pulls sideways or upwards does.
        """
        spread = ONE_BODY.point(self.point.parameters + self._spread)
        change = symmetric.to_matrix(needed(spread, rows, residuals))
        return bool(np.linalg.eigvalsh(change)[0] > -1.0)
