"""Prior that couples parameters, and the fit of a problem with it.

Minus twice the log prior is ``|R t|^2`` with the tangent coordinates t at its mean. It enters the fit as rows,
linearised where the fit ended, until that point does not move: the minimum is that of the geodesic prior. A block of
coordinates that contradicts the prior is released from it, by the weight that a t-distribution gives to its distance.
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

RELEASED_BELOW = 0.5
"""Weight below which a block is reported as released."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CoupledPrior(ABC):
    """Prior of some of a problem's parameters.

    Attributes:
        problem: the problem, without the prior's rows.
        columns: its parameters with this prior ``(k,)``.
        manifold, mean: manifold of these, and the point at which their tangent coordinates are zero.
        names: names of the blocks that can be released.
        freedom: degrees of freedom of the t-distribution of each block's distance.
    """

    problem: Problem
    columns: IntArray
    manifold: ParameterManifold
    mean: Point
    names: tuple[str, ...]
    freedom: float

    @abstractmethod
    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """Rows ``(r, k)`` of the tangent coordinates, for these weights of the blocks."""

    @abstractmethod
    def block_distances(self, weights: Mapping[str, float], /) -> Iterable[FloatArray]:
        """Rows ``(r, k)`` per block that map the tangent coordinates to its distance, in units of the default size."""

    @abstractmethod
    def release_warnings(self, weights: Mapping[str, float]) -> Iterator[str]:
        """Yield a sentence for each block that was released."""

    @property
    def trusted(self) -> dict[str, float]:
        """Weights of the blocks if none is released."""
        return dict.fromkeys(self.names, 1.0)

    def tangent(self, point: Point) -> FloatArray:
        """Coordinates ``(k,)`` at the mean of a point of the problem's manifold."""
        return self.manifold.log(self.mean, self.manifold.point(point.parameters[self.columns]))

    def problem_at(self, point: Point, weights: Mapping[str, float]) -> Problem:
        """Return the problem with the prior's rows, linearised at ``point``, for these weights of the blocks."""
        tangent, root = self.tangent(point), self.root(weights)
        blocks, diagonal = self.manifold.exp_jacobian(self.mean, tangent)
        rows = np.zeros((len(root), self.problem.model.dimension))
        rows[:, self.columns] = self.manifold.by_blocks(root, np.asarray(np.linalg.inv(blocks)), 1.0 / diagonal)
        targets = rows @ point.parameters - root @ tangent
        return self.problem.with_known_rows(WeighedRows(rows, targets))

    def weights(self, found: Fit, before: Mapping[str, float]) -> dict[str, float]:
        """Weights of the blocks, from the expected squares of their coordinates at a fit."""
        tangent = self.tangent(found.search_point)
        expected = np.column_stack([tangent, self._covariance_root(found, tangent)])
        weights = {}
        for name, off in zip(self.names, self.block_distances(before), strict=True):
            square = float(np.sum((off @ expected) ** 2))
            weights[name] = min(1.0, (self.freedom + len(off)) / (self.freedom + square))
        return weights

    def _covariance_root(self, fit: Fit, tangent: FloatArray) -> FloatArray:
        """Root ``(k, r)`` of the posterior covariance, in the prior's coordinates."""
        parent, manifold = self.problem.manifold, self.manifold
        blocks, diagonal = manifold.exp_jacobian(self.mean, tangent)
        links = manifold.point(fit.search_point.parameters[self.columns]).links_jacobian
        rest = parent.jacobian(fit.search_point)[1][self.columns[manifold.inertial.stop :] - parent.inertial.stop]
        root = definite.roots(fit.information, int(np.max(self.columns, initial=-1)) + 1)[self.columns]
        moved = np.swapaxes(np.linalg.solve(blocks, links), -1, -2)
        return manifold.by_blocks(root.T, moved, rest / diagonal).T


def fit_with_coupled_prior(
    prior: CoupledPrior, solve: Callable[..., Fit], given: Mapping[str, float] | None = None
) -> tuple[Fit, Mapping[str, float]]:
    """Fit a problem with a coupled prior.

    Args:
        prior: the prior of the problem.
        solve: fits a problem, like :func:`~geomid_ros.estimation.fit.fit` with its other arguments fixed.
        given: the weights of the prior's blocks, if known.

    Returns:
        The fit of the problem with the prior's rows, and the weights of the prior's blocks. ``budget_exhausted`` is
        True for a fit that did not settle.
    """
    given = given and {**prior.trusted, **given}  # blocks that are not given keep their prior
    found = solve(prior.problem_at(prior.problem.prior_point, given or prior.trusted))
    weights = given or prior.weights(found, prior.trusted)
    for _ in range(ROUNDS):
        point, before = found.search_point, weights
        found = solve(prior.problem_at(point, weights), start=point, prior_stds=found.prior_stds)
        weights = given or prior.weights(found, before)
        change = max(abs(np.log(weights[name] / before[name])) for name in weights)
        if change < SETTLED and np.max(np.abs(prior.tangent(found.search_point) - prior.tangent(point))) < SETTLED:
            return found, weights
    return replace(found, budget_exhausted=True), weights
