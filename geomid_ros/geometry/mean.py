"""The Karcher mean (23): the point with the least weighted sum of squared distances to given points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray


def karcher_mean(
    manifold: ParameterManifold,
    points: Sequence[Point],
    weights: FloatArray,
    tolerance: float = 1e-13,
    max_steps: int = 200,
) -> Point:
    """Weighted Karcher mean of ``points`` with positive ``weights``, one each.

    It exists and is unique. Riemannian gradient descent, halving the step whenever the gradient does not shrink, stops
    when the gradient's norm is below ``tolerance`` (tangent coordinates) or no longer shrinks.
    """
    shares = weights / np.sum(weights)
    mean = points[int(np.argmax(shares))]
    gradient = _mean_logarithm(manifold, mean, points, shares)
    for _ in range(max_steps):
        best = float(np.linalg.norm(gradient))
        if best <= tolerance:
            return mean
        hessian = sum(
            share * manifold.half_squared_distance_hessian(mean, point)
            for share, point in zip(shares, points, strict=True)
        )
        newton, step = np.linalg.solve(hessian, gradient), 1.0
        while step > 1e-6:
            candidate = manifold.exp(mean, step * newton)
            candidate_gradient = _mean_logarithm(manifold, candidate, points, shares)
            if np.linalg.norm(candidate_gradient) < best:
                break
            step *= 0.5
        else:
            return mean
        mean, gradient = candidate, candidate_gradient
    return mean


def _mean_logarithm(
    manifold: ParameterManifold, base: Point, points: Sequence[Point], shares: FloatArray
) -> FloatArray:
    logarithms = np.array([manifold.log(base, point) for point in points])
    result: FloatArray = shares @ logarithms
    return result
