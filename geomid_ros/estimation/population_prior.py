"""A robot's fit beside the population of its type, whose covariance is the prior's.

The covariance of the block of a link, or of an effect, that is let go is divided by its weight, and correlations stay.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.coupled_prior import DOUBTED, CoupledPrior
from geomid_ros.estimation.population import SHARED, Population
from geomid_ros.estimation.posterior import beyond_prior
from geomid_ros.estimation.problem import Problem
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

_LOOSE = 1.0  # spread of the links' own priors, which only keep what the population does not tell from running away


@dataclass(frozen=True, eq=False)
class PopulationPrior(CoupledPrior):
    """A ``population`` as the prior of a problem's parameters; what it does not know keeps the usual prior."""

    population: Population

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
        return PopulationPrior(replace(problem, given=given, given_spreads=spreads), columns, known)

    @property
    def manifold(self) -> ParameterManifold:
        """The population's."""
        return self.population.manifold

    @property
    def mean(self) -> Point:
        """The population's."""
        return self.population.point

    @property
    def names(self) -> tuple[str, ...]:
        """The links and the effects of the population."""
        return tuple(self.population.blocks)

    @cached_property
    def _own(self) -> FloatArray:
        """Standard deviations of the problem's own prior, in the population's coordinates."""
        manifold, own = self.problem.manifold, self.problem.prior_spreads.copy()
        own[manifold.real] *= manifold.scales
        found = own[self.columns]
        found[self.population.manifold.real] /= self.population.scales
        return found

    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """What the population knows beyond the problem's own prior ``(k, k)``."""
        spreads = self._own.copy()
        for name, block in self.population.blocks.items():
            spreads[block] *= weights[name] ** 0.5
        return np.asarray(beyond_prior(self.population.covariance, spreads) / self._own)

    @property
    def freedom(self) -> float:
        """Of its robots."""
        return self.population.robots + SHARED

    def offs(self, _: Mapping[str, float], /) -> Iterator[FloatArray]:
        """In units of the population's covariance."""
        for name in self.names:
            block = self.population.blocks[name]
            rows = np.zeros((len(block), len(self.columns)))
            factor = np.linalg.cholesky(self.population.covariance[np.ix_(block, block)])
            rows[:, block] = np.linalg.inv(factor)
            yield rows

    def unlike(self, weights: Mapping[str, float]) -> Iterator[str]:
        """A sentence for each link or effect that is unlike those of the population."""
        for name, weight in weights.items():
            if weight < DOUBTED:
                what = f"link '{name}'" if name in self.population.links else f"the {name.replace('_', ' ')} of joints"
                yield (
                    f"{what} differs from that of the {self.population.robots} robots of the prior and was released "
                    "from it; check for a tool left on, a repair, or a robot of another type"
                )
