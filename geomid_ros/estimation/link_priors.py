"""Priors that couple parameters: those of links that are alike, or of the population of the robot's type.

Minus twice the log prior is ``|R t|^2`` with the tangent coordinates t at its mean. It enters each round of a fit as
rows, linearised where the last round ended: the minimum is that of the geodesic prior. A block of coordinates that
contradicts the prior is released from it, by the weight that a t-distribution gives to its distance.

The errors of alike parts have a common part, of the default std s, and an individual part, a fifth of it. With the
tangent coordinates d_i of n links at their priors, mirrored to those of the first, the covariance of the errors is
``s^2 (1 1^T + I / 25)``. To within a hundredth, that is a prior of each link alone with std ``s sqrt(n)``, and rows
that tie the links to their mean. Robots differ in how alike their parts are: one weight, from the deviations of all
links together, widens the individual parts of all. A link that is unlike the others is released alone.

With the population of a robot's type, the population's covariance is that of the prior. If the block of a link or of an
effect is released, its covariance is divided by its weight, and correlations stay.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.fit import CERTAINTY, Coupling, Fit, prior_std_cost, reestimated_prior_stds
from geomid_ros.estimation.population import SHARED, Population
from geomid_ros.estimation.posterior import beyond_prior
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.tolerances import ROUNDS
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.spd import SIZE
from geomid_ros.model.alike_parts import ALIKE_PRIOR_STD, AlikeParts
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.types import FloatArray, IntArray

_RELEASED_BELOW = 0.5  # weight below which a block is reported as released
_LOOSE = 1.0  # prior std of the links alone; it only bounds directions that the population leaves undetermined


def common_prior_stds(parts: Sequence[AlikeParts], default_stds: FloatArray) -> FloatArray:
    """Prior std of each link alone ``(links,)``; the ``default_stds (links,)`` ones are for its total error."""
    prior_stds = default_stds.copy()
    for group in parts:
        prior_stds[list(group.members)] *= np.sqrt(len(group.members))
    return prior_stds


def deviation_from_common(parts: Sequence[AlikeParts], individual_stds: FloatArray, values: FloatArray) -> FloatArray:
    """Deviations ``(n, 10, k)`` of the n alike links from their common part, for ``values (10 links, k)`` of the
    tangent coordinates of all links. The common part is the mean, weighted by the individual stds ``individual_stds
    (n,)``."""
    deviations, first = [np.zeros((0, SIZE, values.shape[1]))], 0
    for group in parts:
        members = np.array(group.members)[:, None] * SIZE + np.arange(SIZE)
        mirrored = np.array(group.signs)[:, :, None] * values[members]
        precisions = individual_stds[first : first + len(members)] ** -2.0
        deviations.append(mirrored - np.tensordot(precisions / np.sum(precisions), mirrored, 1))
        first += len(members)
    return np.concatenate(deviations)


def alike_rows(parts: Sequence[AlikeParts], individual_stds: FloatArray, size: int) -> FloatArray:
    """Rows ``(10 n, size)`` of the prior: the deviations from the common part, in units of the individual stds."""
    return np.asarray(
        (deviation_from_common(parts, individual_stds, np.eye(size)) / individual_stds[:, None, None]).reshape(-1, size)
    )


def reestimated_individual_stds(
    parts: Sequence[AlikeParts], individual_stds: FloatArray, tangent: FloatArray, root: FloatArray
) -> FloatArray:
    """Re-estimate the individual stds ``(n,)`` from those before; ``tangent (k,)``: coordinates of all links,
    ``root (k, r)``: a root of their covariance."""
    off = deviation_from_common(parts, individual_stds, tangent[:, None]).ravel()
    variances = np.sum(deviation_from_common(parts, individual_stds, root) ** 2, axis=2).ravel()
    return reestimated_prior_stds(off, variances, np.full(len(individual_stds), ALIKE_PRIOR_STD))


def individual_std_cost(parts: Sequence[AlikeParts], individual_stds: FloatArray) -> float:
    """Minus twice the log density of the individual stds ``individual_stds (n,)``, with the normalisation of the rows,
    up to a constant."""
    cost, first = prior_std_cost(individual_stds, np.full(len(individual_stds), ALIKE_PRIOR_STD)), 0
    for group in parts:
        precisions = individual_stds[first : first + len(group.members)] ** -2.0
        cost += SIZE * float(np.log(np.sum(precisions)) - np.sum(np.log(precisions)))
        first += len(precisions)
    return cost


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
    def common_weight(self, squares: FloatArray, sizes: FloatArray, /) -> float:
        """Weight of all blocks, from their squared distances and the numbers of their coordinates ``(blocks,)``."""

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
        return self.problem.with_known_rows(self.rows_at(self.manifold.point(point.parameters[self.columns]), weights))

    def rows_at(self, point: Point, weights: Mapping[str, float]) -> WeighedRows:
        """Rows of the prior, linearised at a ``point`` of its manifold, for these weights of the blocks."""
        tangent, root = self.manifold.log(self.mean, point), self.root(weights)
        blocks, diagonal = self.manifold.exp_jacobian(self.mean, tangent)
        rows = np.zeros((len(root), self.problem.model.dimension))
        rows[:, self.columns] = self.manifold.by_blocks(root, np.asarray(np.linalg.inv(blocks)), 1.0 / diagonal)
        return WeighedRows(rows, rows[:, self.columns] @ point.parameters - root @ tangent)

    def weights(self, found: Fit, before: Mapping[str, float]) -> dict[str, float]:
        """Weights of the blocks, from the expected squares of their coordinates at a fit."""
        tangent = self.tangent(found.search_point)
        expected = np.column_stack([tangent, self._covariance_root(found, tangent)])
        squares, sizes = np.zeros((2, len(self.names)))
        for block, off in enumerate(self.block_distances(before)):
            (used,) = np.nonzero(np.any(off, axis=0))
            squares[block], sizes[block] = np.sum((off[:, used] @ expected[used]) ** 2), len(off)
        common = self.common_weight(squares, sizes)
        weights = np.minimum(1.0, common * (self.freedom + sizes) / (self.freedom + common * squares))
        return dict(zip(self.names, weights.tolist(), strict=True))

    def _covariance_root(self, fit: Fit, tangent: FloatArray) -> FloatArray:
        """Root ``(k, r)`` of the posterior covariance, in the prior's coordinates."""
        parent, manifold = self.problem.manifold, self.manifold
        blocks, diagonal = manifold.exp_jacobian(self.mean, tangent)
        links = manifold.point(fit.search_point.parameters[self.columns]).links_jacobian
        rest = parent.jacobian(fit.search_point)[1][self.columns[manifold.inertial.stop :] - parent.inertial.stop]
        root = spd.roots(fit.information, int(np.max(self.columns, initial=-1)) + 1)[self.columns]
        moved = np.swapaxes(np.linalg.solve(blocks, links), -1, -2)
        return manifold.by_blocks(root.T, moved, rest / diagonal).T


@dataclass(frozen=True, eq=False, kw_only=True)
class AlikePrior(CoupledPrior):
    """Prior of the groups of alike ``parts``; its blocks are their links."""

    parts: Sequence[AlikeParts]

    @staticmethod
    def of(parts: Sequence[AlikeParts], problem: Problem) -> AlikePrior:
        """Build the prior of a problem whose links have the URDF's prior."""
        separate = replace(problem, given_stds=common_prior_stds(parts, problem.default_stds))
        manifold = ParameterManifold(len(problem.model.body_names), 0, np.zeros(0))
        columns = np.arange(manifold.dimension)
        return AlikePrior(
            problem=separate,
            columns=columns,
            manifold=manifold,
            mean=manifold.point(problem.prior_inertias),
            names=tuple(name for group in parts for name in group.names),
            freedom=CERTAINTY,
            parts=parts,
        )

    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """Deviation of each link from the common part, in units of its individual std."""
        return alike_rows(self.parts, self._individual_stds(weights), len(self.columns))

    def block_distances(self, weights: Mapping[str, float], /) -> FloatArray:
        """Deviation of each link from the weighted mean of the alike ones, in units of the default individual std."""
        stds, units = self._individual_stds(weights), np.eye(len(self.columns))
        return np.asarray(deviation_from_common(self.parts, stds, units) / ALIKE_PRIOR_STD)

    def common_weight(self, squares: FloatArray, sizes: FloatArray, /) -> float:
        """Weight of all links: how alike the parts of this robot are, apart from those that are unlike the others."""
        common = 1.0
        for _ in range(ROUNDS):
            parts = (self.freedom + sizes) / (self.freedom + common * squares) * squares
            common = min(1.0, float((self.freedom + np.sum(sizes)) / (self.freedom + np.sum(parts))))
        return common

    def _individual_stds(self, weights: Mapping[str, float]) -> FloatArray:
        return ALIKE_PRIOR_STD * np.array([weights[name] for name in self.names]) ** -0.5

    def release_warnings(self, weights: Mapping[str, float]) -> Iterator[str]:
        """Yield a sentence if all links are unlike, and one for each that is unlike the others."""
        largest = max(weights.values(), default=1.0)
        if largest < _RELEASED_BELOW:
            yield (
                "parts that are identical in the URDF differ from each other, so that their priors are hardly coupled; "
                "check repairs and loads, or give '--alike none'"
            )
        for group in self.parts:
            for name in group.names:
                if weights[name] < _RELEASED_BELOW * largest:
                    others = ", ".join(other for other in group.names if other != name)
                    yield (
                        f"link '{name}' differs from {others}, which are identical parts in the URDF; its prior is no "
                        "longer coupled to theirs; check for a repair or a load on it, or give '--alike none'"
                    )


@dataclass(frozen=True, eq=False, kw_only=True)
class PopulationPrior(CoupledPrior):
    """Prior from a ``population``; parameters that it does not contain keep the default prior. Its blocks are the
    population's links and effects."""

    population: Population

    @staticmethod
    def of(population: Population, problem: Problem) -> PopulationPrior:
        """Build the prior of a problem whose own prior is loosened.

        Raises:
            InputError: the population is of robots with other links.
        """
        model = problem.model
        links = [name for name in model.body_names if name in population.links]
        if not links:
            raise InputError(
                f"the population has no link of this robot: its links are {', '.join(population.links)}, the robot's "
                f"are {', '.join(model.body_names)}"
            )
        named = {(effect.name, effect.place, effect.parameter): effect for effect in population.effects}
        first = 10 * len(model.body_names)
        effects = {
            column: named[key]
            for column, c in enumerate(model.coefficients, first)
            if (key := (c.effect.name, c.place_name, c.parameter)) in named
        }
        subset = population.part(links, list(effects.values()))
        places = [10 * model.body_names.index(name) + k for name in links for k in range(10)]
        columns = np.array([*places, *effects])
        given = np.full(model.dimension, np.nan)
        given[columns] = subset.parameters
        prior_stds = np.where(np.isfinite(given[:first:10]), _LOOSE, problem.default_stds)
        return PopulationPrior(
            problem=replace(problem, given_parameters=given, given_stds=prior_stds),
            columns=columns,
            manifold=subset.manifold,
            mean=subset.point,
            names=tuple(subset.blocks),
            freedom=subset.robots + SHARED,
            population=subset,
        )

    @cached_property
    def _own(self) -> FloatArray:
        """Standard deviations of the problem's separate prior, in the population's coordinates."""
        manifold, stds = self.problem.manifold, self.problem.prior_stds.copy()
        stds[manifold.real] *= manifold.scales
        converted = stds[self.columns]
        converted[self.population.manifold.real] /= self.population.scales
        return converted

    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """Root ``(k, k)`` of the population's information beyond the problem's separate prior."""
        prior_stds = self._own.copy()
        for name, block in self.population.blocks.items():
            prior_stds[block] *= weights[name] ** 0.5
        return np.asarray(beyond_prior(self.population.covariance, prior_stds) / self._own)

    def block_distances(self, _: Mapping[str, float], /) -> Iterator[FloatArray]:
        """Yield rows that whiten each block by the population's covariance."""
        for block in self.population.blocks.values():
            rows = np.zeros((len(block), len(self.columns)))
            rows[:, block] = np.linalg.inv(np.linalg.cholesky(self.population.covariance[np.ix_(block, block)]))
            yield rows

    def common_weight(self, _squares: FloatArray, _sizes: FloatArray, /) -> float:
        """One: the population's covariance is that of its robots."""
        return 1.0

    def release_warnings(self, weights: Mapping[str, float]) -> Iterator[str]:
        """Yield a sentence for each link or effect that is unlike the population's."""
        for name, weight in weights.items():
            if weight < _RELEASED_BELOW:
                label = f"link '{name}'" if name in self.population.links else f"the {name.replace('_', ' ')} of joints"
                yield (
                    f"{label} differs from that of the {self.population.robots} robots of the prior, which no longer "
                    "constrains it; check for a tool left on, a repair, or a robot of another type"
                )


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
    found = solve(prior.problem_at(prior.problem.prior_point, given or prior.trusted), rough=True)
    weights, point = given or prior.weights(found, prior.trusted), found.search_point
    linearised = _Linearised(prior, np.log([weights[name] for name in prior.names]), weights_given=given is not None)
    problem = prior.problem_at(point, weights)
    found = solve(problem, start=point, prior_stds=found.prior_stds, coupling=linearised)
    return found, linearised.weights


@dataclass
class _Linearised(Coupling):
    """A prior that is linearised where each round begins; its ``state (n,)``: logarithms of its blocks' weights."""

    prior: CoupledPrior
    state: FloatArray
    weights_given: bool

    @property
    def weights(self) -> dict[str, float]:
        """Weights of the blocks, at most one."""
        return dict(zip(self.prior.names, np.exp(np.minimum(self.state, 0.0)).tolist(), strict=True))

    def next_state(self, found: Fit) -> FloatArray:
        """See :class:`Coupling`."""
        weights = self.weights if self.weights_given else self.prior.weights(found, self.weights)
        return np.log([weights[name] for name in self.prior.names])

    def problem_in(self, state: FloatArray, point: Point) -> Problem:
        """See :class:`Coupling`."""
        self.state = state
        return self.prior.problem_at(point, self.weights)
