"""The fit of all parameters to summarised rows, when neither the noise nor the prior's errors are known in advance.

Minus twice the logarithm of the likelihood is ``sum_k N_k (log s_k^2 + S_k / (N_k s_k^2))`` with the standard deviation
s_k of each group of rows, which is estimated, and its sum of squares S_k. A link's error is Gaussian in geodesic
distance, of a spread of its own. Its square has an inverse-gamma distribution about the usual one, whose tails are
heavy: a link that the data call wrong is let go, and loosens no other. The spreads maximise the marginal likelihood in
Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.objective import Evaluation, ProductsObjective, ResidualObjective, row_weights
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.solvers import Extrapolation, Solution, trust_region
from geomid_ros.estimation.starting_point import USUAL_SPREAD
from geomid_ros.estimation.tolerances import LEAST_GRADIENT, ROUNDS, SETTLED
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import Point
from geomid_ros.geometry.symmetric import SIZE
from geomid_ros.types import FloatArray

CERTAINTY = 20.0
"""The usual spread counts as much as the directions of two links."""
INDEPENDENT = 2.67
"""Independent rows per period of the filter's cutoff, which leaves nothing above 1.5 times this frequency."""
_BUDGET = 3  # times the solver's steps, of all rounds together: five times what measured robots ask for
_SETTLED = 1e-7  # relative change of standard deviations and spreads, which falls to about a third in a round
_SETTLED_WARM = 1e-8  # the same where rounds are extrapolated, so that few more are needed


def likely_spreads(
    off: FloatArray, variances: FloatArray, usual: FloatArray, certainty: float = CERTAINTY
) -> FloatArray:
    """MacKay's re-estimate ("Bayesian interpolation", 1992) ``(links,)``: the mean square of each link's error, what
    the data leave undetermined included.

    Args:
        off: tangent coordinates ``(10 links,)`` of the links from their priors.
        variances: of these ``(10 links,)``, by the data and the priors.
        usual: spreads ``(links,)``, geodesic distances.
        certainty: how many directions the usual spread counts as much as.
    """
    squares = np.sum((off**2 + variances).reshape(-1, SIZE), axis=1)
    return np.asarray(np.sqrt((squares + certainty * usual**2) / (SIZE + certainty)))


def cost_of_spreads(spreads: FloatArray, usual: FloatArray, certainty: float = CERTAINTY) -> float:
    """Minus twice the logarithm of the distribution of ``spreads (links,)``, up to a constant."""
    relative = spreads / usual
    return certainty * float(np.sum(relative**-2.0 + 2.0 * np.log(relative)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """Where the search for the noise and the spreads ended, and the minimum there.

    Attributes:
        problem: what was fitted.
        place: where the search ended, by products of the rows.
        sigmas: standard deviations ``(groups,)``.
        spreads: of the prior's errors ``(links,)``, geodesic distances.
        spent: whether the budget of steps ended the search for noise and spreads.
        tolerance, max_steps: as of :func:`fit`.
    """

    problem: Problem
    place: Point
    sigmas: FloatArray
    spreads: FloatArray
    spent: bool
    tolerance: float
    max_steps: int

    @cached_property
    def rows(self) -> tuple[FloatArray, FloatArray]:
        """What was measured, ``(N, D)`` and ``(N,)`` of standard deviation 1."""
        return self.problem.rows(self.sigmas)

    @cached_property
    def objective(self) -> ResidualObjective:
        """What was minimised, with the noise and the prior's weights that were found."""
        return _objective(self.problem, self.rows, self.spreads)

    @cached_property
    def solution(self) -> Solution:
        """The minimum by the rows themselves."""
        return trust_region(self.objective, self.place, _gradient(self.objective, self.tolerance), self.max_steps)

    @property
    def gamma(self) -> float:
        """The links' weight in the prior as a share of the measured rows'."""
        return self.problem.gamma or self.objective.prior_weight / _measured_weight(self.problem, self.rows)

    @property
    def point(self) -> Point:
        """The parameters."""
        return self.solution.point

    @property
    def assumed_spreads(self) -> FloatArray:
        """Standard deviations ``(D,)`` of the prior's error, tangent coordinates."""
        return _every_spread(self.problem, self.spreads)

    @cached_property
    def _rough(self) -> ProductsObjective:
        return _rough(self.problem, self.sigmas, self.spreads)

    @cached_property
    def _evaluation(self) -> Evaluation:
        return self._rough.evaluate(self.place)

    @cached_property
    def information(self) -> FloatArray:
        """That of the independent rows and of the prior ``(D, D)``, tangent coordinates at the :attr:`place`."""
        weights = np.diag(self._rough.prior_weights)
        return np.asarray(self.problem.independent * (self._evaluation.information + weights))

    @cached_property
    def score(self) -> float:
        """Minus twice the logarithm of the marginal likelihood in Laplace's approximation, up to what is the same for
        all fits of a problem. There are several minima: a link that takes over what an effect does leaves its prior."""
        problem = self.problem
        volume = definite.log_determinant(self.information)
        likelihood = 2.0 * problem.independent * (self._evaluation.value + float(problem.counts @ np.log(self.sigmas)))
        widths = float(np.sum(np.log(problem.independent * self._rough.prior_weights)))
        return likelihood + volume - widths + cost_of_spreads(self.spreads, problem.usual)


def fit(
    problem: Problem,
    start: Point | None = None,
    spreads: FloatArray | None = None,
    *,
    tolerance: float,
    max_steps: int,
) -> Fit:
    """Fit all parameters, the noise of each group and the spread of each link.

    Args:
        problem: what is fitted.
        start: where to start; the prior unless given.
        spreads: of the links, to start with; the usual ones unless given.
        tolerance: largest geodesic distance of the result from the minimum.
        max_steps: of the solver, for each noise and spreads.
    """
    point = start or problem.prior_point
    spreads = problem.usual if spreads is None or problem.gamma is not None else spreads
    sigmas = problem.noise(point.parameters) if start is not None else problem.first_noise
    # Near its fixed point the iteration is linear: it can be extrapolated, and one step for each noise is enough.
    extrapolation, most = (None, max_steps) if start is None else (Extrapolation(), 1)
    steps, spent, within = 0, False, _SETTLED if start is None else _SETTLED_WARM
    for _ in range(ROUNDS):
        rough = _rough(problem, sigmas, spreads)
        solution = trust_region(rough, point, _gradient(rough, tolerance), most)
        point, steps = solution.point, steps + solution.steps
        begun = np.log(np.concatenate([sigmas, spreads]))
        sigmas = problem.noise(point.parameters)
        if problem.gamma is None:
            spreads = _spreads(problem, rough, solution)
        ended = np.log(np.concatenate([sigmas, spreads]))
        if np.all(np.abs(ended - begun) < within):
            break
        spent = steps > _BUDGET * max_steps
        if spent:
            break
        if extrapolation is not None:
            sigmas, spreads = np.split(np.exp(extrapolation.next(begun, ended)), [len(sigmas)])
    return Fit(
        problem=problem,
        place=point,
        sigmas=sigmas,
        spreads=spreads,
        spent=spent,
        tolerance=tolerance,
        max_steps=max_steps,
    )


def likelier(solve: Callable[..., Fit], other: Point, spreads: FloatArray | None) -> Callable[..., Fit]:
    """A solver, such as :func:`fit`, that begins a second time, at another point with other ``spreads (links,)``, where
    it is given none: of two minima it takes the more likely one."""

    def best(problem: Problem, start: Point | None = None, **more: FloatArray) -> Fit:
        if start is not None:
            return solve(problem, start, **more)
        first, second = solve(problem), solve(problem, other, spreads)
        return second if second.score < first.score - SETTLED else first

    return best


def _rough(problem: Problem, sigmas: FloatArray, spreads: FloatArray) -> ProductsObjective:
    """The objective for this noise and these spreads of the links, for the search for both."""
    precisions = sigmas**-2.0
    products = problem.products.weighed(precisions)
    measured = float(precisions @ problem.row_weights)
    weights = _prior_weights(problem, spreads, measured)
    rows = measured + problem.known_weight
    return ProductsObjective(problem.manifold, products, problem.prior_point, weights, rows, problem.known_products)


def _prior_weights(problem: Problem, spreads: FloatArray, measured: float) -> FloatArray:
    """Weights ``(D,)`` of the squared distance to the prior, for these spreads of the links and rows of this weight."""
    usual = _every_spread(problem, spreads)
    if problem.gamma is not None:
        return np.asarray(problem.gamma * measured * (USUAL_SPREAD / usual) ** 2)
    # Of the rows only a share counts: in units of all of them the prior, and what was weighed, are as much heavier.
    return np.asarray(usual**-2.0 / problem.independent)


def _every_spread(problem: Problem, spreads: FloatArray) -> FloatArray:
    """Spreads ``(D,)`` of all priors, for these of the links."""
    every = problem.prior_spreads.copy()
    every[problem.manifold.inertial] = np.repeat(spreads, 10)
    return every


def _gradient(objective: ResidualObjective | ProductsObjective, tolerance: float) -> float:
    """The prior bounds the curvature from below: a gradient of ``tolerance`` times its weight is at most that far
    off."""
    return max(tolerance * min(float(np.min(objective.prior_weights)) / objective.scale, 1.0), LEAST_GRADIENT)


def _objective(problem: Problem, measured: tuple[FloatArray, FloatArray], spreads: FloatArray) -> ResidualObjective:
    """The objective for these rows and these spreads of the links."""
    manifold, prior = problem.manifold, problem.prior_point
    weights = _prior_weights(problem, spreads, _measured_weight(problem, measured))
    factor = np.sqrt(max(1.0, 1.0 / problem.independent))
    rows = np.concatenate([measured[0], factor * problem.known.rows])
    targets = np.concatenate([measured[1], factor * problem.known.targets])
    ones = np.ones(len(rows))
    links = float(np.exp(np.mean(np.log(weights[manifold.inertial]))))
    every = float(np.sum(row_weights(manifold, prior, rows, ones)))
    gamma, known = max(links / every, np.finfo(float).tiny), len(problem.known.rows)
    return ResidualObjective(manifold, rows, targets, ones, prior, gamma, confidence=weights / links, known=known)


def _measured_weight(problem: Problem, measured: tuple[FloatArray, FloatArray]) -> float:
    """The sum of the measured rows' weights."""
    rows, _ = measured
    return float(np.sum(row_weights(problem.manifold, problem.prior_point, rows, np.ones(len(rows)))))


def _spreads(problem: Problem, objective: ProductsObjective, solution: Solution) -> FloatArray:
    """MacKay's re-estimate of each link's: the mean square of its error, what the data leave undetermined included."""
    manifold = problem.manifold
    links = manifold.inertial
    information = solution.evaluation.information + np.diag(objective.prior_weights)
    unsure = definite.variances(problem.independent * information, links.stop)
    return likely_spreads(manifold.log(problem.prior_point, solution.point)[links], unsure, problem.usual)
