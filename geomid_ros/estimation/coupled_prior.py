"""A prior that couples parameters, beside which a problem is fitted.

Minus twice the logarithm of the prior is ``|R t|^2`` with the tangent coordinates t at its mean. It enters the fit as
rows, linearised where the fit ended, until that does not move: the minimum is that of the geodesic prior. A block of
coordinates that is unlike what the prior says is let go, by the weight that a t-distribution gives to its distance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.fit import Fit
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.tolerances import ROUNDS, SETTLED
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray

DOUBTED = 0.5
"""A block of less weight is told."""


@dataclass(frozen=True, eq=False)
class CoupledPrior(ABC):
    """A prior of some parameters, the ``columns (k,)`` of a ``problem``."""

    problem: Problem
    columns: IntArray

    @property
    @abstractmethod
    def manifold(self) -> ParameterManifold:
        """That of its parameters."""

    @property
    @abstractmethod
    def mean(self) -> Point:
        """Where its tangent coordinates are zero."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Its blocks."""

    @abstractmethod
    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """Rows ``(r, k)`` of the tangent coordinates, for these weights of the blocks."""

    @property
    @abstractmethod
    def freedom(self) -> float:
        """Degrees of freedom of the t-distribution of each block's distance."""

    @abstractmethod
    def offs(self, weights: Mapping[str, float], /) -> Iterable[FloatArray]:
        """Of each block rows ``(r, k)`` that take the tangent coordinates to its distance in usual sizes."""

    @abstractmethod
    def unlike(self, weights: Mapping[str, float]) -> Iterator[str]:
        """A sentence for each block that was let go."""

    @property
    def trusted(self) -> dict[str, float]:
        """The weights of the blocks, if nothing is let go."""
        return dict.fromkeys(self.names, 1.0)

    def tangent(self, point: Point) -> FloatArray:
        """Coordinates ``(k,)`` of a point of the problem's manifold at the mean."""
        return self.manifold.log(self.mean, self.manifold.point(point.parameters[self.columns]))

    def problem_at(self, point: Point, weights: Mapping[str, float]) -> Problem:
        """The problem with the prior's rows, linearised at a point of its manifold, for these weights of the blocks."""
        tangent, root = self.tangent(point), self.root(weights)
        blocks, diagonal = self.manifold.exp_jacobian(self.mean, tangent)
        rows = np.zeros((len(root), self.problem.model.dimension))
        rows[:, self.columns] = self.manifold.by_blocks(root, np.asarray(np.linalg.inv(blocks)), 1.0 / diagonal)
        targets = rows @ point.parameters - root @ tangent
        return self.problem.beside(WeighedRows(rows, targets))

    def weights(self, found: Fit, before: Mapping[str, float]) -> dict[str, float]:
        """The weights of the blocks, by the expected squares of their coordinates at a fit."""
        tangent = self.tangent(found.place)
        expected = np.column_stack([tangent, self._unsure(found, tangent)])
        weights = {}
        for name, off in zip(self.names, self.offs(before), strict=True):
            square = float(np.sum((off @ expected) ** 2))
            weights[name] = min(1.0, (self.freedom + len(off)) / (self.freedom + square))
        return weights

    def _unsure(self, found: Fit, tangent: FloatArray) -> FloatArray:
        """A root ``(k, r)`` of the posterior's covariance, in the prior's coordinates."""
        whole, own = self.problem.manifold, self.manifold
        blocks, diagonal = own.exp_jacobian(self.mean, tangent)
        links = own.point(found.place.parameters[self.columns]).links_jacobian
        rest = whole.jacobian(found.place)[1][self.columns[own.inertial.stop :] - whole.inertial.stop]
        root = definite.roots(found.information, int(np.max(self.columns, initial=-1)) + 1)[self.columns]
        moved = np.swapaxes(np.linalg.solve(blocks, links), -1, -2)
        return own.by_blocks(root.T, moved, rest / diagonal).T


def fit_beside(
    prior: CoupledPrior, solve: Callable[..., Fit], given: Mapping[str, float] | None = None
) -> tuple[Fit, Mapping[str, float]]:
    """Fit beside a prior.

    Args:
        prior: of the problem.
        solve: fits a problem, as :func:`~geomid_ros.estimation.fit.fit` with its other arguments.
        given: the weights of the prior's blocks, if they are known.

    Returns:
        The fit, of the problem with the prior's rows, and the weights of the prior's blocks. A fit that did not settle
        has ``spent`` its budget.
    """
    given = given and {**prior.trusted, **given}  # with blocks of which nothing is told
    found = solve(prior.problem_at(prior.problem.prior_point, given or prior.trusted))
    weights = given or prior.weights(found, prior.trusted)
    for _ in range(ROUNDS):
        point, before = found.place, weights
        found = solve(prior.problem_at(point, weights), start=point, spreads=found.spreads)
        weights = given or prior.weights(found, before)
        change = max(abs(np.log(weights[name] / before[name])) for name in weights)
        if change < SETTLED and np.max(np.abs(prior.tangent(found.place) - prior.tangent(point))) < SETTLED:
            return found, weights
    return replace(found, spent=True), weights
