"""What the joint fit minimises for channels of unknown noise, and the steps in which it does so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.objective import Evaluation, linear_hessian
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class StraightManifold(ParameterManifold):
    """The manifold with steps along straight lines of the parameters instead of geodesics."""

    def exp(self, base: Point, tangent: FloatArray) -> Point:
        """The end of the straight step that leaves ``base`` with tangent coordinates ``(D,)``."""
        return self.straight(base, tangent)


@dataclass(frozen=True, eq=False)
class ProfileObjective:
    """Half of ``sum_c N_c log S_c`` plus the prior's terms, with weights ``(D,)`` of the tangent coordinates to it, and
    with ``known (r, D + 1)`` rows of standard deviation 1, whose last column are their residuals at the prior."""

    manifold: ParameterManifold
    products: FloatArray
    counts: FloatArray
    least: FloatArray
    prior: Point
    weights: FloatArray
    known: FloatArray

    @property
    def scale(self) -> float:
        """Number of all rows."""
        return float(np.sum(self.counts))

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """The end of a step along a straight line."""
        return self.manifold.straight(point, tangent)

    def squares(self, point: Point) -> FloatArray:
        """Sums of squares ``(C,)`` of the channels at ``point``, at least ``least (C,)``."""
        vector = np.append(point.parameters, -1.0)
        return np.asarray(np.maximum((self.products @ vector) @ vector, self.least))

    def evaluate(self, point: Point) -> Evaluation:
        """Value, gradient, information and Hessian along straight lines at ``point``."""
        vector = np.append(point.parameters, -1.0)
        moved = self.products @ vector
        squares = np.maximum(moved @ vector, self.least)
        weights = self.counts / squares
        slope = self.manifold.whiten(point, (weights @ moved)[None, :-1])[0]
        rows = np.tensordot(weights, self.products, axes=1)[:-1, :-1]
        off = self.known @ np.append(point.parameters - self.prior.parameters, 1.0)
        normals = self.manifold.whiten(point, self.known[:, :-1])
        slope += off @ normals
        information = self.manifold.whiten(point, self.manifold.whiten(point, rows).T) + normals.T @ normals
        to_prior, curvature = self.manifold.log_and_hessian(point, self.prior)
        root = np.sqrt(self.weights)
        curvature = root[:, None] * curvature * root
        value = 0.5 * float(self.counts @ np.log(squares) + self.weights @ to_prior**2 + off @ off)
        # Along a straight line the data have no curvature but their information; the prior has that of the line.
        hessian = information + curvature + linear_hessian(self.manifold, self.weights * to_prior)
        return Evaluation(value, slope - self.weights * to_prior, information, hessian)
