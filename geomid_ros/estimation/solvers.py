"""Solvers: a trust region on the manifold and the paper's alternation; and extrapolation of fixed-point iterations."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.estimation.objective import Evaluation, Objective
from geomid_ros.estimation.tolerances import LARGEST_STEP, ROUNDING
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import Point
from geomid_ros.types import FloatArray

_ACCEPT = 1e-4
_SHRINK_BELOW = 0.25  # and expand above one minus this
# Relative to the objective's value. Its rounding, which grows with the links' condition number, may hide a decrease
# smaller than the first; no step decreases it by less than the second.
_HIDDEN = 1e-10
_ROUNDING = 1e-13
_NEARLY = 0.99  # of the radius: a step that long counts as one to the boundary
_REMEMBERED = 6  # last rounds of a fixed-point iteration
GRADIENT = 1e-8
"""Gradient norm at which a solve ends, as a fraction of the objective's scale."""
_, _FLAT, _SETTLED, _ROUNDED = ENDS = (
    (False, "no convergence in {} steps"),
    (True, "gradient below tolerance"),
    (True, "decrease below the least"),
    (True, "no decrease left in rounding"),
)
"""Possible ends of a solve: True if it converged, and why it stopped."""


@dataclass(frozen=True, eq=False)
class Solution:
    """End of a solve.

    Attributes:
        point, evaluation: The last point, and the objective there.
        converged, reason: True if it converged, and why it stopped.
        steps: Number of steps.
        values: The objective at the start and after each step.
    """

    point: Point
    evaluation: Evaluation
    converged: bool
    reason: str
    steps: int
    values: tuple[float, ...]


def trust_region(
    objective: Objective,
    start: Point,
    tolerance: float = GRADIENT,
    max_steps: int = 100,
    radius: float = 1.0,
    evaluation: Evaluation | None = None,
    least_decrease: float = 0.0,
) -> Solution:
    """Minimise by Newton steps on the manifold inside a trust region.

    The subproblem is solved as by More & Sorensen (1983); the radius follows the ratio of actual to predicted decrease
    (Nocedal & Wright, "Numerical Optimization", algorithm 4.1). Every accepted step descends; where rounding hides the
    descent, the gradient shrinks.

    Args:
        objective: The objective.
        start: Where to start.
        tolerance: Gradient norm at which to stop, as a fraction of the objective's scale.
        max_steps: Largest number of steps.
        radius: First radius, a geodesic distance.
        evaluation: The objective at ``start``, if it is known already.
        least_decrease: Least predicted decrease for which a Newton step is taken. For half a chi-square, 1e-3 leaves
            every parameter within a twentieth of its standard deviation.
    """
    scale = objective.scale
    evaluation = evaluation or objective.evaluate(start)
    point, values = start, [evaluation.value]
    for step in range(max_steps):
        if np.linalg.norm(evaluation.gradient) <= tolerance * scale:
            return Solution(point, evaluation, *_FLAT, step, tuple(values))
        while True:
            tangent = quadratic_minimiser(evaluation, radius)
            predicted = -(evaluation.gradient @ tangent + 0.5 * tangent @ evaluation.hessian @ tangent)
            length = float(np.linalg.norm(tangent))
            if predicted < least_decrease and length < radius:
                return Solution(point, evaluation, *_SETTLED, step, tuple(values))
            candidate, trial = _tried(objective, point, evaluation, tangent)
            ratio = float((evaluation.value - trial.value) / predicted)
            if ratio >= _ACCEPT:
                break
            size = abs(evaluation.value)  # rounding can make a value less than zero
            hidden = predicted <= _HIDDEN * size
            if hidden and np.linalg.norm(trial.gradient) <= 0.5 * np.linalg.norm(evaluation.gradient):
                ratio = 1.0
                break
            if predicted <= _ROUNDING * size:
                return Solution(point, evaluation, *_ROUNDED, step, tuple(values))
            radius = 0.25 * length
        if ratio < _SHRINK_BELOW:
            radius = 0.25 * length
        elif ratio > 1.0 - _SHRINK_BELOW and length >= _NEARLY * radius:
            radius = 2.0 * radius
        point, evaluation = candidate, trial
        values.append(evaluation.value)
    return Solution(point, evaluation, False, f"no convergence in {max_steps} steps", max_steps, tuple(values))


def _tried(objective: Objective, point: Point, evaluation: Evaluation, tangent: FloatArray) -> tuple[Point, Evaluation]:
    """Return the end of a step and the objective there. If that is too far away for finite numbers, return the point
    itself with an infinite value, so that a shorter step is tried."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            candidate = objective.step(point, tangent)
            trial = objective.evaluate(candidate)
        except LinAlgError:
            return point, replace(evaluation, value=np.inf)
    finite = all(np.all(np.isfinite(part)) for part in (trial.value, trial.gradient, trial.hessian))
    return (candidate, trial) if finite else (point, replace(evaluation, value=np.inf))


def quadratic_minimiser(evaluation: Evaluation, radius: float) -> FloatArray:
    """Minimiser of the quadratic model ``g . x + x . H x / 2`` in a ball about zero.

    It is ``-(H + mu 1)^-1 g`` with the least mu >= 0 for which ``H + mu 1`` is positive definite and the step fits.

    A step that does not fit without mu ends in the ball's last hundredth, by Newton's iteration for the inverse of its
    length (Nocedal & Wright, algorithm 4.3) inside a bracket. If the gradient has no part along the eigenvector of the
    least eigenvalue, it ends at the least mu but for rounding.

    Raises:
        LinAlgError: g or H is not finite.
    """
    gradient, hessian = evaluation.gradient, evaluation.hessian
    if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(hessian))):
        raise LinAlgError("the objective's derivatives are not finite")
    smallest = _ROUNDING * max(float(np.linalg.norm(hessian)), float(np.linalg.norm(gradient)) / radius)
    low, high, damping = 0.0, np.inf, 0.0
    fitting: FloatArray | None = None
    while fitting is None or high - max(low, smallest) > ROUNDING * high:
        try:
            trial, bend = spd.damped_step(hessian, gradient, damping)
            length = float(np.linalg.norm(trial))
        except LinAlgError:  # not positive definite
            length = np.inf
        if length <= radius:
            high, fitting = damping, trial
            if damping == 0.0 or not 0.0 < length < _NEARLY * radius:
                break
        else:
            low = damping
        if length < np.inf:
            damping += length**2 / bend * (length / (0.5 * (1.0 + _NEARLY) * radius) - 1.0)
        if length == np.inf or not low < damping < high:
            least = max(low, smallest)
            damping = float(np.sqrt(least * high)) if fitting is not None else 10.0 * least
    return fitting


def cyclic(objective: Objective, start: Point, tolerance: float = 1e-8, max_steps: int = 20000) -> Solution:
    """Minimise (19) by the paper's alternation: project on every hyperplane, then move to the Karcher mean.

    All projections of a cycle share the base point, so their mean's first Karcher step needs no further decomposition:
    it is the weighted mean of the tangent vectors Q_i, and the full mean has the same fixed points. A step that does
    not descend is halved.
    """
    scale = objective.scale
    evaluation = objective.evaluate(start)
    point, values = start, [evaluation.value]
    for step in range(max_steps):
        if np.linalg.norm(evaluation.gradient) <= tolerance * scale:
            return Solution(point, evaluation, *_FLAT, step, tuple(values))
        fraction = 1.0
        while True:
            candidate, trial = _tried(objective, point, evaluation, -fraction / scale * evaluation.gradient)
            hidden = abs(trial.value - evaluation.value) <= _HIDDEN * evaluation.value
            shrinks = np.linalg.norm(trial.gradient) < np.linalg.norm(evaluation.gradient)
            if trial.value < evaluation.value or (hidden and shrinks):
                break
            fraction *= 0.5
            if fraction < 1e-6:
                return Solution(point, evaluation, *_ROUNDED, step, tuple(values))
        point, evaluation = candidate, trial
        values.append(evaluation.value)
    return Solution(point, evaluation, False, f"no convergence in {max_steps} cycles", max_steps, tuple(values))


SOLVERS: dict[str, Callable[..., Solution]] = {"trust_region": trust_region, "cyclic": cyclic}


class Extrapolation:
    """Accelerate fixed-point iterations ``x <- g(x)`` (Anderson; Walker & Ni, SIAM J. Numer. Anal., 2011).

    The next round starts at the combination of the last rounds that would move least if g were linear."""

    def __init__(self) -> None:
        self._rounds: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=_REMEMBERED)

    def next(self, begun: FloatArray, ended: FloatArray) -> FloatArray:
        """Next x ``(n,)`` after a round that started at x and ended at g(x)."""
        self._rounds.append((ended, ended - begun))
        ends, moves = (np.array(arrays).T for arrays in zip(*self._rounds, strict=True))
        coefficients, *_ = np.linalg.lstsq(np.diff(moves), moves[:, -1], rcond=ROUNDING)
        correction = np.diff(ends) @ coefficients
        if not np.max(np.abs(correction)) <= LARGEST_STEP:
            self._rounds.clear()
            return ended
        return np.asarray(ended - correction)
