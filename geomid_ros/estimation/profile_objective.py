"""Fit for channels of unknown noise, with the noise profiled out: objective, minimisation and evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.estimation.channel_products import ChannelProducts, SelectedProducts
from geomid_ros.estimation.objective import Evaluation, with_prior
from geomid_ros.estimation.solvers import ENDS, GRADIENT, Solution, trust_region
from geomid_ros.estimation.tolerances import LEAST_DECREASE, ROUNDS, SETTLED
from geomid_ros.geometry import compiled, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.pseudo_inertia import COEFFICIENTS_TO_COORDINATES
from geomid_ros.types import FloatArray

_STEPS = 40
_RADIUS = 16.0  # of the first step: when an effect is added or removed, others move as far as its size
LEAST_SHARE = 1e-10
"""Least residual sum of squares, as a fraction of the target's."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Data of C channels of unknown noise: ``products`` of the D columns and the target, ``counts
    (C,)`` of rows, the ``prior``, and ``floors (C,)`` of the noise."""

    manifold: ParameterManifold
    products: ChannelProducts | SelectedProducts
    counts: FloatArray
    prior: Point
    floors: FloatArray | float = 0.0

    @cached_property
    def least(self) -> FloatArray:
        """Lower bound of each sum of squares ``(C,)``."""
        smallest = LEAST_SHARE * self.products.targets + np.finfo(float).tiny
        return np.asarray(np.maximum(smallest, self.counts * np.square(self.floors)))

    def squares(self, point: Point) -> FloatArray:
        """Sums of squares ``(C,)`` of the channels at ``point``, at least ``least (C,)``."""
        return np.maximum(self.products.squares(np.append(point.parameters, -1.0)), self.least)


@dataclass(frozen=True, eq=False)
class ProfileObjective:
    """Half of ``sum_c N_c log S_c``, or for a channel below its floor ``N_c (log F_c + S_c / F_c - 1)`` as of known
    noise; plus the prior's terms, with ``weights (D,)`` of the tangent coordinates to it, equal within a link; plus
    those of ``known`` rows of standard deviation 1, by their products ``(D + 1, D + 1)``
    (:func:`~geomid_ros.estimation.objective.products_at`)."""

    profile: Profile
    weights: FloatArray
    known: FloatArray

    @property
    def manifold(self) -> ParameterManifold:
        """Manifold of its points."""
        return self.profile.manifold

    @property
    def scale(self) -> float:
        """Number of all rows."""
        return float(np.sum(self.profile.counts))

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """End of a straight step."""
        return self.manifold.straight(point, tangent)

    def evaluate(self, point: Point) -> Evaluation:
        """Return value, gradient, information and Hessian along straight lines at ``point``."""
        profile = self.profile
        vector = np.append(point.parameters, -1.0)
        squares, products = profile.products.weighed_by_squares(vector, profile.counts, profile.least)
        noise = np.maximum(squares, profile.least)
        value, slope = 0.5 * float(profile.counts @ (np.log(noise) + squares / noise - 1.0)), (products @ vector)[:-1]
        return with_prior(self.manifold, point, profile.prior, self.weights, (value, slope, products), self.known)


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """End of a fit: the ``point``, the ``scales`` of the prior, and the objective there."""

    objective: ProfileObjective
    point: Point
    scales: FloatArray
    evaluation: Evaluation

    @cached_property
    def hessian(self) -> FloatArray:
        """Information ``(D, D)`` of the rows and of the prior, in tangent coordinates."""
        return np.asarray(self.evaluation.information + np.diag(self.objective.weights))

    @cached_property
    def score(self) -> float:
        """Minus twice the log marginal likelihood in Laplace's approximation, for these scales."""
        volume = spd.log_determinant(self.hessian)
        return 2.0 * self.evaluation.value + volume - float(np.sum(np.log(self.objective.weights)))


def fit_scales(
    objective: Callable[[FloatArray], ProfileObjective],
    start: Point,
    scales: FloatArray,
    likely: Callable[[Point, FloatArray, FloatArray], FloatArray] | None,
) -> ProfileFit:
    """Minimise for the most likely ``scales (n,)`` of the prior, by MacKay's fixed point.

    Args:
        objective: builds the objective for given scales.
        start, scales: where to start.
        likely: next scales, from the minimum, the Hessian ``(D, D)`` there and the scales so far; None to keep the
            given scales.
    """
    point = start
    for _ in range(ROUNDS):
        trial = objective(scales)
        solution = minimum(trial, point)
        point, before = solution.point, scales
        if likely is None:
            return ProfileFit(trial, point, scales, solution.evaluation)
        scales = likely(point, solution.evaluation.information + np.diag(trial.weights), scales)
        if np.all(np.abs(np.log(scales) - np.log(before)) < SETTLED):  # an inflation may begin at infinity
            break
    trial = objective(scales)
    return ProfileFit(trial, point, scales, trial.evaluate(point))


def minimum(objective: ProfileObjective, start: Point) -> Solution:
    """Minimise from ``start``, to a twentieth of the parameters' standard deviations."""
    manifold, profile, native = objective.manifold, objective.profile, compiled.native
    if native is None or manifold.positives:
        return trust_region(objective, start, max_steps=_STEPS, radius=_RADIUS, least_decrease=LEAST_DECREASE)
    size, prior = manifold.dimension, profile.prior
    inertias, reals, values = start.pseudo_inertias.copy(), start.reals.copy(), np.empty(_STEPS + 1)
    gradient, information, hessian = np.empty(size), np.empty((size, size)), np.empty((size, size))
    reason, steps = native.descend(
        *(COEFFICIENTS_TO_COORDINATES, prior.to_tangent, prior.pseudo_inertias, prior.reals),
        *(manifold.scales, objective.weights),
        *(*profile.products.packed, profile.counts, profile.least, objective.known),
        np.array([GRADIENT * objective.scale, _RADIUS, LEAST_DECREASE]),
        *(inertias, reals, gradient, information, hessian, values),
    )
    if reason == len(ENDS):
        raise LinAlgError("the objective's derivatives are not finite")
    converged, message = ENDS[reason]
    evaluation = Evaluation(float(values[steps]), gradient, information, hessian)
    point, history = Point(inertias, prior.positives, reals), tuple(values[: steps + 1].tolist())
    return Solution(point, evaluation, converged, message.format(steps), steps, history)
