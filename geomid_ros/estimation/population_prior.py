"""A robot's fit beside the population of its type, whose covariance is the prior's.

Minus twice the logarithm of the prior is ``t^T C^-1 t`` with the tangent coordinates t at the population's mean. It
enters the fit as rows, linearised where the fit ended, until that does not move: the minimum is that of the geodesic
prior. A link, or an effect, that is unlike those of the population is let go: the covariance of its block is divided by
the weight that a t-distribution gives to its distance, and correlations stay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.fit import Fit
from geomid_ros.estimation.population import SHARED, Population
from geomid_ros.estimation.posterior import beyond_prior
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.tolerances import ROUNDS, SETTLED
from geomid_ros.geometry.manifold import Point
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray

_LOOSE = 1.0  # spread of the links' own priors, which only keep what the population does not tell from running away
_DOUBTED = 0.5  # a block of less weight is told


@dataclass(frozen=True, eq=False)
class PopulationPrior:
    """A ``population`` as the prior of a ``problem``'s parameters; what it does not know keeps the usual prior."""

    population: Population
    problem: Problem
    columns: IntArray

    @staticmethod
    def of(population: Population, problem: Problem) -> PopulationPrior:
        """The prior of a problem, of whose own prior next to nothing is left.

        Raises:
            InputError: the population is of robots with other links.
        """
        model = problem.model
        links = [name for name in model.body_names if name in population.links]
        if not links:
            raise InputError(
                f"the prior is of another type of robot: its links are {', '.join(population.links)}, those of "
                f"this robot {', '.join(model.body_names)}"
            )
        named = {(effect.name, effect.place, effect.parameter): effect for effect in population.effects}
        first = 10 * len(model.body_names)
        effects = {
            column: named[key]
            for column, c in enumerate(model.coefficients, first)
            if (key := (c.effect.name, c.place_name, c.parameter)) in named
        }
        known = population.part(links, list(effects.values()))
        places = [10 * model.body_names.index(name) + k for name in links for k in range(10)]
        columns = np.array([*places, *effects])
        given = np.full(model.dimension, np.nan)
        given[columns] = known.parameters
        spreads = np.where(np.isfinite(given[:first:10]), _LOOSE, problem.usual)
        return PopulationPrior(known, replace(problem, given=given, given_spreads=spreads), columns)

    @cached_property
    def _own(self) -> FloatArray:
        """Standard deviations of the problem's own prior, in the population's coordinates."""
        manifold, own = self.problem.manifold, self.problem.prior_spreads.copy()
        own[manifold.real] *= manifold.scales
        found = own[self.columns]
        found[self.population.manifold.real] /= self.population.scales
        return found

    def tangent(self, point: Point) -> FloatArray:
        """Coordinates of a point of the problem's manifold at the population's mean."""
        population = self.population
        there = population.manifold.point(point.parameters[self.columns])
        return population.manifold.log(population.point, there)

    def problem_at(self, point: Point, weights: Mapping[str, float]) -> Problem:
        """The problem with the population's rows, linearised at a point of its manifold, for these weights of the
        blocks."""
        population, tangent, known = self.population, self.tangent(point), self.problem.known
        spreads = self._own.copy()
        for name, block in population.blocks.items():
            spreads[block] *= weights[name] ** 0.5
        # The rows are what the population knows beyond the problem's own prior.
        root = beyond_prior(population.covariance, spreads) / self._own
        rows = np.zeros((len(root), self.problem.model.dimension))
        rows[:, self.columns] = np.linalg.solve(self._derivative(tangent).T, root.T).T
        targets = rows @ point.parameters - root @ tangent
        return replace(self.problem, known=known.plus(WeighedRows(rows, targets)))

    def _derivative(self, tangent: FloatArray) -> FloatArray:
        return self.population.manifold.exp_derivative(self.population.point, tangent)

    def weights(self, found: Fit) -> dict[str, float]:
        """The weights of the blocks, by the expected squares of their coordinates at a fit."""
        population, tangent = self.population, self.tangent(found.point)
        covariance = self._covariance(found, tangent)
        squares = np.outer(tangent, tangent) + covariance
        freedom = population.robots + SHARED
        weights = {}
        for name, block in population.blocks.items():
            own = np.ix_(block, block)
            square = float(np.trace(np.linalg.solve(population.covariance[own], squares[own])))
            weights[name] = min(1.0, (freedom + len(block)) / (freedom + square))
        return weights

    def _covariance(self, found: Fit, tangent: FloatArray) -> FloatArray:
        """The posterior's, in the population's coordinates."""
        manifold, point = self.problem.manifold, found.point
        information = found.solution.evaluation.information + np.diag(found.objective.prior_weights)
        derivative = manifold.exp_derivative(point, np.zeros(manifold.dimension))[self.columns]
        moved = np.linalg.solve(self._derivative(tangent), derivative)
        return np.asarray(moved @ np.linalg.solve(self.problem.independent * information, moved.T))


def fit_with_population(prior: PopulationPrior, solve: Callable[..., Fit]) -> tuple[Fit, dict[str, float]]:
    """Fit beside a population.

    Args:
        prior: of the problem.
        solve: fits a problem, as :func:`~geomid_ros.estimation.fit.fit` with its other arguments.

    Returns:
        The fit, of the problem with the population's rows, and the weights of the population's blocks.
    """
    found = solve(prior.problem_at(prior.problem.prior_point, dict.fromkeys(prior.population.blocks, 1.0)))
    weights = prior.weights(found)
    for _ in range(ROUNDS):
        point, before = found.point, weights
        found = solve(prior.problem_at(point, weights), start=point, spreads=found.spreads)
        weights = prior.weights(found)
        change = max(abs(np.log(weights[name] / before[name])) for name in weights)
        if change < SETTLED and np.max(np.abs(prior.tangent(found.point) - prior.tangent(point))) < SETTLED:
            break
    return found, weights


def unlike_population(prior: PopulationPrior, weights: Mapping[str, float]) -> Iterator[str]:
    """A sentence for each link or effect that is unlike those of the population."""
    for name, weight in weights.items():
        if weight < _DOUBTED:
            what = f"link '{name}'" if name in prior.population.links else f"the {name.replace('_', ' ')} of joints"
            yield (
                f"{what} differs from that of the {prior.population.robots} robots of the prior and was released from "
                f"it; "
                "check for a tool left on, a repair, or a robot of another type"
            )
