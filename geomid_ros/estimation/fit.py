"""Fit all parameters to summarised rows, when neither the noise nor the prior's errors are known in advance.

Minus twice the log-likelihood is ``sum_k N_k (log s_k^2 + S_k / (N_k s_k^2))``. The standard deviation s_k of each
group of rows is estimated; S_k is its sum of squares. A link's error is Gaussian in geodesic distance, with a prior std
per link. The square of that prior std has an inverse-gamma distribution about the default. Its tails are heavy: a link
that contradicts the data is released from its prior, and loosens no other. The prior stds maximise the marginal
likelihood in Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from geomid_ros.estimation.objective import Evaluation, ResidualObjective
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.solvers import Extrapolation, Solution, trust_region
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.estimation.tolerances import LEAST_DECREASE, LEAST_GRADIENT, ROUNDS, SETTLED
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.spd import SIZE
from geomid_ros.types import FloatArray

CERTAINTY = 20.0
"""Weight of the default prior std, in directions of the tangent space: as much as two links."""
INDEPENDENT_ROWS_PER_PERIOD = 2.67
"""Independent rows per period of the filter's cutoff; the filter passes nothing above 1.5 times the cutoff."""
_BUDGET = 3  # times max_steps, for all rounds together: five times what measured robots need
_SETTLED = 1e-8  # change of logarithms of noise and prior stds in a round


def reestimated_prior_stds(
    off: FloatArray, variances: FloatArray, default_stds: FloatArray, certainty: float = CERTAINTY
) -> FloatArray:
    """Re-estimate the prior std of each link ``(links,)`` by MacKay ("Bayesian interpolation", 1992): the mean square
    of its error, including the posterior variance.

    Args:
        off: tangent coordinates ``(10 links,)`` of the links, from their priors.
        variances: posterior variances ``(10 links,)`` of these.
        default_stds: default prior std ``(links,)``, geodesic distances.
        certainty: weight of the default prior std, in directions of the tangent space.
    """
    squares = np.sum((off**2 + variances).reshape(-1, SIZE), axis=1)
    return np.asarray(np.sqrt((squares + certainty * default_stds**2) / (SIZE + certainty)))


def prior_std_cost(prior_stds: FloatArray, default_stds: FloatArray, certainty: float = CERTAINTY) -> float:
    """Minus twice the log density of ``prior_stds (links,)``, up to a constant."""
    relative = prior_stds / default_stds
    return certainty * float(np.sum(relative**-2.0 + 2.0 * np.log(relative)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """Result of the search for noise and prior std, and the minimum for these.

    Attributes:
        problem: the fitted problem.
        search_point: end of the search.
        sigmas: standard deviations ``(groups,)``.
        prior_stds: prior std of each link ``(links,)``, geodesic distances.
        budget_exhausted: True if the search ended before it settled, because its steps or rounds were used up.
        tolerance, max_steps: see :func:`fit`.
    """

    problem: Problem
    search_point: Point
    sigmas: FloatArray
    prior_stds: FloatArray
    budget_exhausted: bool
    tolerance: float
    max_steps: int

    @cached_property
    def rows(self) -> tuple[FloatArray, FloatArray]:
        """Measured rows ``(N, D)`` and targets ``(N,)`` of standard deviation 1."""
        return self.problem.summary.compressed(self.sigmas, self.problem.manifold.dimension)

    @cached_property
    def objective(self) -> ResidualObjective:
        """Objective with the noise and the prior weights that the search found."""
        return _objective(self.problem, self.sigmas, self.prior_stds)

    @cached_property
    def solution(self) -> Solution:
        """Minimum of :attr:`objective`."""
        return trust_region(
            self.objective, self.search_point, _gradient(self.objective, self.tolerance), self.max_steps
        )

    @property
    def gamma(self) -> float:
        """Weight of the links' prior as a fraction of the measured rows' weight."""
        links, measured = self.problem.manifold.inertial, float(self.sigmas**-2.0 @ self.problem.row_weights)
        return self.problem.gamma or float(np.exp(np.mean(np.log(self.objective.prior_weights[links])))) / measured

    @property
    def point(self) -> Point:
        """Parameters at the minimum."""
        return self.solution.point

    @cached_property
    def fold_products(self) -> FloatArray:
        """Gram matrices ``(folds, D + 1, D + 1)`` of the measured rows of each fold, of standard deviation 1."""
        return self.problem.summary.products(self.sigmas, self.problem.manifold.dimension)

    @property
    def assumed_prior_stds(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error, tangent coordinates."""
        return _all_prior_stds(self.problem, self.prior_stds)

    @cached_property
    def _evaluation(self) -> Evaluation:
        return self.objective.evaluate(self.search_point)

    @cached_property
    def information(self) -> FloatArray:
        """Information ``(D, D)`` of the independent rows and of the prior, in tangent coordinates at
        :attr:`search_point`."""
        weights = np.diag(self.objective.prior_weights)
        return np.asarray(self.problem.independent_fraction * (self._evaluation.information + weights))

    @cached_property
    def score(self) -> float:
        """Minus twice the log marginal likelihood in Laplace's approximation, up to a constant of the problem. There
        are several minima: a link that absorbs an effect leaves its prior."""
        problem = self.problem
        volume = spd.log_determinant(self.information)
        likelihood = (
            2.0 * problem.independent_fraction * (self._evaluation.value + float(problem.counts @ np.log(self.sigmas)))
        )
        widths = float(np.sum(np.log(problem.independent_fraction * self.objective.prior_weights)))
        wider = np.maximum(self.prior_stds / problem.default_stds, 1.0)[[*problem.masses_held]]
        widths += 2.0 * float(np.sum(np.log(wider)))
        return likelihood + volume - widths + prior_std_cost(self.prior_stds, problem.default_stds)


class Coupling(Protocol):
    """Determines the problem of each round of a fit by a ``state (n,)``."""

    state: FloatArray

    def next_state(self, found: Fit) -> FloatArray:
        """State ``(n,)`` that follows from the fit so far."""

    def problem_in(self, state: FloatArray, point: Point) -> Problem:
        """Take this state, and return the problem in it, which is solved from ``point``."""


def fit(
    problem: Problem,
    start: Point | None = None,
    prior_stds: FloatArray | None = None,
    *,
    tolerance: float,
    max_steps: int,
    coupling: Coupling | None = None,
    rough: bool = False,
) -> Fit:
    """Fit all parameters, the noise of each group and the prior std of each link.

    Args:
        problem: the problem to fit.
        start: where to start; the prior unless given.
        prior_stds: prior std of the links to start with; the default ones unless given.
        tolerance: largest geodesic distance of the result from the minimum.
        max_steps: largest number of solver steps per round, in which noise and prior std are fixed.
        coupling: determines the problem of all rounds but the first; the same problem unless given.
        rough: True to end within :data:`SETTLED`, where another fit starts.
    """
    point = start or problem.prior_point
    prior_stds = problem.default_stds if prior_stds is None or problem.gamma is not None else prior_stds
    sigmas = problem.noise(point.parameters) if start is not None else problem.first_noise
    # Near its fixed point the iteration is linear: it can be extrapolated, and one solver step per round is enough.
    extrapolation, steps = None, 0
    for _ in range(ROUNDS):
        with_masses = problem.with_masses_at(point, prior_stds)
        objective = _objective(with_masses, sigmas, prior_stds)
        most, least = (max_steps, LEAST_DECREASE) if extrapolation is None else (1, 0.0)
        gradient = _gradient(objective, tolerance)
        solution = trust_region(objective, point, gradient, most, least_decrease=least)
        point, steps = solution.point, steps + solution.steps
        before = np.log(np.concatenate([sigmas, prior_stds]))
        sigmas = problem.noise(point.parameters)
        if problem.gamma is None:
            prior_stds = _spreads(problem, objective, solution)
        found = Fit(
            problem=with_masses,
            search_point=point,
            sigmas=sigmas,
            prior_stds=prior_stds,
            budget_exhausted=True,
            tolerance=tolerance,
            max_steps=max_steps,
        )
        after, size = np.log(np.concatenate([sigmas, prior_stds])), len(before)
        if coupling is not None:
            before, after = np.append(before, coupling.state), np.append(after, coupling.next_state(found))
        moves = np.abs(after - before)
        if steps > _BUDGET * max_steps:
            break
        if extrapolation is not None:
            if np.max(moves[:size]) < _SETTLED and np.max(moves) < SETTLED:
                return replace(found, budget_exhausted=False)
            after = extrapolation.next(before, after)
            sigmas, prior_stds = np.split(np.exp(after[:size]), [len(sigmas)])
        elif np.max(moves) < SETTLED:
            if rough:
                return replace(found, budget_exhausted=False)
            extrapolation = Extrapolation()
        if coupling is not None:
            problem = coupling.problem_in(after[size:], point)
    return found


def with_second_start(solve: Callable[..., Fit], other: Point, prior_stds: FloatArray | None) -> Callable[..., Fit]:
    """Wrap a solver such as :func:`fit`: without a start it also solves from ``other`` with other ``prior_stds
    (links,)``, and returns the more likely of the two minima."""

    def best(problem: Problem, start: Point | None = None, **keywords: Any) -> Fit:
        if start is not None:
            return solve(problem, start, **keywords)
        first, second = solve(problem, **keywords), solve(problem, other, prior_stds, **keywords)
        return second if second.score < first.score - SETTLED else first

    return best


def with_fitted_effects(objective: ResidualObjective, point: Point) -> Point:
    """Point with the links of ``point``, at which the effects minimise an objective."""
    manifold, links = objective.manifold, objective.manifold.inertial
    if links.stop == manifold.dimension:
        return point
    of_effects = np.eye(manifold.dimension + 1)[:, links.stop :]
    in_rows, from_prior = of_effects.copy(), of_effects.copy()
    in_rows[links, -1] = -point.parameters[links]
    from_prior[links, -1] = manifold.offset(objective.prior, point)[links]
    effects = ResidualObjective(
        ParameterManifold(0, manifold.positives, manifold.scales),
        in_rows.T @ objective.products @ in_rows,
        _without_links(objective.prior),
        objective.prior_weights[links.stop :],
        objective.rows_weight,
        None if objective.known is None else from_prior.T @ objective.known @ from_prior,
    )
    found = trust_region(effects, _without_links(point)).point
    return Point(point.pseudo_inertias, found.positives, found.reals)


def _without_links(point: Point) -> Point:
    return Point(point.pseudo_inertias[:0], point.positives, point.reals)


def _objective(problem: Problem, sigmas: FloatArray, prior_stds: FloatArray) -> ResidualObjective:
    """Build the objective for this noise and these prior stds of the links."""
    precisions = sigmas**-2.0
    products = problem.products.weighed(precisions)
    measured = float(precisions @ problem.row_weights)
    weights = _prior_weights(problem, prior_stds, measured)
    rows = measured + problem.known_weight
    return ResidualObjective(problem.manifold, products, problem.prior_point, weights, rows, problem.known_products)


def _prior_weights(problem: Problem, prior_stds: FloatArray, measured: float) -> FloatArray:
    """Weights ``(D,)`` of the squared distance to the prior; ``measured``: weight of the measured rows."""
    prior_std = _all_prior_stds(problem, prior_stds)
    if problem.gamma is not None:
        return np.asarray(problem.gamma * measured * (DEFAULT_PRIOR_STD / prior_std) ** 2)
    # All rows enter the objective, but only a fraction is independent: prior and weighed masses count more in return.
    return np.asarray(prior_std**-2.0 / problem.independent_fraction)


def _all_prior_stds(problem: Problem, prior_stds: FloatArray) -> FloatArray:
    """Prior std ``(D,)`` of all coordinates, for these prior stds of the links."""
    all_stds = problem.prior_stds.copy()
    all_stds[problem.manifold.inertial] = np.repeat(prior_stds, 10)
    return all_stds


def _gradient(objective: ResidualObjective, tolerance: float) -> float:
    """Relative gradient at which the solver stops. The prior bounds the curvature from below: a gradient of
    ``tolerance`` times its weight is at most that far from the minimum."""
    return max(tolerance * min(float(np.min(objective.prior_weights)) / objective.scale, 1.0), LEAST_GRADIENT)


def _spreads(problem: Problem, objective: ResidualObjective, solution: Solution) -> FloatArray:
    """MacKay's re-estimate of the prior std of each link (:func:`reestimated_prior_stds`)."""
    manifold = problem.manifold
    links = manifold.inertial
    information = solution.evaluation.information + np.diag(objective.prior_weights)
    variances = spd.variances(problem.independent_fraction * information, links.stop)
    return reestimated_prior_stds(
        manifold.log(problem.prior_point, solution.point)[links], variances, problem.default_stds
    )
