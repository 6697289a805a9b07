"""Population of the robots of one type, random effects on the manifold; and robots unlike the others.

A robot's parameters are ``exp(m, t)``. The Karcher mean m belongs to the type; the tangent coordinates t are normal
with the covariance S between robots. A robot's rows inform on t; its separate prior does not enter. The URDF is the
prior of the mean, so that directions which no data identify stay as uncertain as they were. Expectation-maximisation
(Dempster, Laird and Rubin 1977; Laird and Ware 1982): the expectation solves for the mean and every robot jointly, with
the rows linearised at each robot; then S is the mean of the expected squares. First S has one variance for all links
and one for each effect. Then it is free, but shrunk towards that: few robots determine no full covariance.

Following the minimum covariance determinant (Rousseeuw 1984), the population of a fleet is that of the most alike half.
Then, round by round, it includes all robots that are no farther from it than members are. So the others do not move it,
as long as they are less than half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.posterior import EffectCoordinate, RobotParameters, effect_columns
from geomid_ros.estimation.starting_point import default_prior_stds
from geomid_ros.estimation.tolerances import LARGEST_STEP, LEAST_DEVIATION, ROUNDS, SETTLED
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray, IntArray, frozen

FEWEST = 3
"""Least number of robots for a population."""
SHARED = 10.0
"""Weight of the common variance, in robots."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotLikelihood(RobotParameters):
    """Likelihood of one robot's parameters by its data, without any prior.

    Attributes:
        rows, targets: ``(N, D)`` and ``(N,)``: ``rows . parameters = targets`` with independent errors of standard
            deviation 1.
        prior: the parameters ``(D,)`` that its estimate started from.
    """

    rows: FloatArray
    targets: FloatArray
    prior: FloatArray

    @staticmethod
    def of(estimate: Estimate) -> RobotLikelihood:
        """Build the likelihood from an estimate."""
        posterior = estimate.posterior
        arguments = {name: getattr(posterior, name) for name in ("links", "effects", "parameters", "prior", "scales")}
        return RobotLikelihood(rows=estimate.rows, targets=estimate.targets, **arguments)

    def of_effects(self, effects: Sequence[EffectCoordinate]) -> RobotLikelihood:
        """Likelihood of the links and these effects alone, with the other effects eliminated."""
        kept = self.columns(self.links, effects)
        others = np.setdiff1d(np.arange(len(self.parameters)), kept)
        stacked = np.column_stack([self.rows, self.targets])[:, [*others, *kept, -1]]
        reduced = triangular(stacked)[len(others) :, len(others) :]
        return self._part(self.links, effects, rows=reduced[:, :-1], targets=reduced[:, -1], prior=self.prior[kept])


@dataclass(frozen=True, eq=False, kw_only=True)
class Population(RobotParameters):
    """Distribution of a robot's parameters by its type, before its data: ``exp(parameters, N(0, covariance))`` on the
    manifold, where ``parameters`` are the Karcher mean.

    Attributes:
        covariance: ``(D, D)`` of the tangent coordinates at the mean (:mod:`geomid_ros.geometry.manifold`): between
            robots, and of the mean itself.
        robots: number of robots.
    """

    covariance: FloatArray
    robots: int

    def part(self, links: Sequence[str], effects: Sequence[EffectCoordinate]) -> Population:
        """Distribution of some of the links and effects, in the given order."""
        kept = self.columns(links, effects)
        return self._part(links, effects, covariance=self.covariance[np.ix_(kept, kept)])


def common_likelihoods(robots: Sequence[RobotLikelihood]) -> list[RobotLikelihood]:
    """Likelihoods of the links and of the effects that all robots have.

    Raises:
        InputError: there are fewer than :data:`FEWEST`, or they have different links.
    """
    if len(robots) < FEWEST:
        raise InputError(f"a population of {len(robots)} robots, expected at least {FEWEST}")
    if any(robot.links != robots[0].links for robot in robots):
        raise InputError("the robots of a population have different links")
    shared = set.intersection(*(set(robot.effects) for robot in robots))
    effects = [effect for effect in robots[0].effects if effect in shared]
    return [robot.of_effects(effects) for robot in robots]


class _Contribution(NamedTuple):
    """Contribution of a robot in a round: ``information (D, D)`` on the mean, the right-hand side ``pull (D,)`` of
    ``information @ mean = pull``, and its expected ``squares (D, D)``."""

    information: FloatArray
    pull: FloatArray
    squares: FloatArray


class PopulationFit:
    """Population fit to robots that all belong to it, by expectation-maximisation."""

    def __init__(self, robots: Sequence[RobotLikelihood]) -> None:
        """Fit at least :data:`FEWEST` robots with the same links and effects (:func:`common_likelihoods`)."""
        first = robots[0]
        self._robots = robots
        scales = np.median([robot.scales for robot in robots], axis=0)
        self._manifold = manifold = replace(first.manifold, scales=scales)
        starts = np.array([robot.prior for robot in robots])
        starts[:, manifold.inertial] = first.prior[manifold.inertial]
        self._prior = manifold.point(np.median(starts, axis=0))
        self._usual = default_prior_stds(manifold)
        self._mean = self._prior
        self._covariance = np.diag(self._usual**2)
        self._common: FloatArray | None = None
        self._of_mean = np.diag(self._usual**2)
        self._points = [manifold.point(robot.parameters) for robot in robots]
        self._contributions: list[_Contribution] = []
        self._settle()
        self._common = self._covariance
        self._settle()

    @property
    def population(self) -> Population:
        """Population of all robots."""
        return self._population(self._mean, self._covariance + self._of_mean, len(self._robots))

    def without(self, index: int) -> Population:
        """Population of the other robots, by one round."""
        others = [share for place, share in enumerate(self._contributions) if place != index]
        mean_covariance, tangent = self._mean_of([share[:2] for share in others])
        mean = self._manifold.exp(self._mean, tangent)
        return self._population(mean, self._between(others) + mean_covariance, len(others))

    def _population(self, mean: Point, covariance: FloatArray, robots: int) -> Population:
        first = self._robots[0]
        return Population(
            links=first.links,
            effects=first.effects,
            parameters=mean.parameters,
            covariance=frozen(covariance),
            scales=self._manifold.scales,
            robots=robots,
        )

    def _settle(self) -> None:
        """Iterate until a round changes next to nothing."""
        for _ in range(ROUNDS):
            if self._advance():
                break

    def _advance(self) -> bool:
        """Do one round; True if it changed next to nothing."""
        manifold = self._manifold
        between = np.linalg.inv(self._covariance)
        linearised = [linear(manifold, self._mean, *pair) for pair in zip(self._robots, self._points, strict=True)]
        covariances = [np.linalg.inv(between + information) for information, _ in linearised]
        on_mean = [
            (between - between @ covariance @ between, between @ (covariance @ pull))
            for (_, pull), covariance in zip(linearised, covariances, strict=True)
        ]
        self._of_mean, mean = self._mean_of(on_mean)
        self._contributions, ends = [], []
        for share, (_, pull), covariance in zip(on_mean, linearised, covariances, strict=True):
            tangent = covariance @ (between @ mean + pull)
            shrinkage = covariance @ between - np.eye(len(mean))
            squares = np.outer(tangent - mean, tangent - mean) + covariance + shrinkage @ self._of_mean @ shrinkage.T
            self._contributions.append(_Contribution(*share, squares))
            ends.append(tangent)
        before = np.diag(self._covariance)
        self._covariance = self._between(self._contributions)
        self._points = [self._towards(point, end) for point, end in zip(self._points, ends, strict=True)]
        self._mean = manifold.exp(self._mean, mean)
        change = np.max(np.abs(np.log(np.diag(self._covariance) / before)))
        return bool(max(change, np.max(np.abs(mean) / np.sqrt(before))) < SETTLED)

    def _mean_of(self, on_mean: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """Covariance ``(D, D)`` and tangent coordinates ``(D,)`` of the mean, from the prior and each robot's
        information and pull."""
        weights = self._usual**-2.0
        information = np.diag(weights) + np.sum([information for information, _ in on_mean], axis=0)
        pull = weights * self._manifold.log(self._mean, self._prior) + np.sum([pull for _, pull in on_mean], axis=0)
        covariance = np.linalg.inv(information)
        return covariance, covariance @ pull

    def _towards(self, point: Point, end: FloatArray) -> Point:
        """Next point of a robot: that with the tangent coordinates ``end``, or a part of the way there."""
        begin = self._manifold.log(self._mean, point)
        step = end - begin
        return self._manifold.exp(self._mean, begin + step * min(1.0, LARGEST_STEP / max(np.max(np.abs(step)), 1e-12)))

    def _between(self, parts: Sequence[_Contribution]) -> FloatArray:
        """Covariance between robots, from their expected squares."""
        squares = np.sum([part.squares for part in parts], axis=0)
        if self._common is not None:
            return np.asarray((squares + SHARED * self._common) / (len(parts) + SHARED))
        variances = np.diag(squares) / len(parts)
        first = self._manifold.inertial.stop
        effects = effect_columns((effect.name for effect in self._robots[0].effects), first)
        for columns in (np.arange(first), *effects.values()):
            variances[columns] = max(float(np.mean(variances[columns])), LEAST_DEVIATION**2)
        return np.diag(variances)


def linear(
    manifold: ParameterManifold, base: Point, robot: RobotLikelihood, point: Point
) -> tuple[FloatArray, FloatArray]:
    """Normal equations ``information @ t = pull`` of a robot's rows, linearised at ``point``, for its tangent
    coordinates t at ``base``: the information ``(D, D)`` and the pull ``(D,)``."""
    tangent = manifold.log(base, point)
    rows = manifold.by_blocks(robot.rows, *manifold.exp_jacobian(base, tangent))
    targets = robot.targets - robot.rows @ point.parameters + rows @ tangent
    return rows.T @ rows, rows.T @ targets


_CHANCE_OF_ROBOT = 1e-2  # largest probability, over all blocks, that a member is reported as unlike
_IDENTIFIED = 0.1  # least fraction of the variance between robots that the data resolve in a direction that counts


@dataclass(frozen=True, kw_only=True)
class Membership:
    """Distance of a robot from the others of its type.

    Attributes:
        member: True if it is one of them.
        distance: Mahalanobis distance per direction that its data identify, about 1 for a member.
        unlike: names of links and effects in which it is unlike them, the farthest first.
    """

    member: bool
    distance: float
    unlike: tuple[str, ...]


def population_and_members(robots: Sequence[RobotLikelihood]) -> tuple[Population, list[Membership]]:
    """Fit the population of most of these robots, and find its members; of few robots all are members.

    Raises:
        InputError: there are too few, or they have different links.
    """
    shared = common_likelihoods(robots)
    if len(shared) < 2 * FEWEST - 1:  # the half of them is no population
        population = PopulationFit(shared).population
        return population, [Membership(member=True, distance=1.0, unlike=())] * len(shared)
    chosen = _most_alike(shared)
    seen = set()
    while True:
        fit = PopulationFit([shared[index] for index in chosen])
        others = {index: fit.without(place) for place, index in enumerate(chosen)}
        memberships = [_membership(others.get(index, fit.population), robot) for index, robot in enumerate(shared)]
        inside = tuple(index for index, membership in enumerate(memberships) if membership.member)
        if inside in seen or len(inside) < FEWEST:
            return fit.population, memberships
        seen.add(inside)
        chosen = inside


def _most_alike(robots: Sequence[RobotLikelihood]) -> tuple[int, ...]:
    """Indices of the half of the robots whose estimates are nearest to the medians."""
    first = robots[0]
    manifold = replace(first.manifold, scales=np.ones(len(first.scales)))
    base = manifold.point(first.prior)
    coordinates = np.array([manifold.log(base, manifold.point(robot.parameters)) for robot in robots])
    off = coordinates - np.median(coordinates, axis=0)
    deviations = np.median(np.abs(off), axis=0) + LEAST_DEVIATION
    nearest = np.argsort(np.mean((off / deviations) ** 2, axis=1), kind="stable")
    return tuple(sorted(nearest[: max(FEWEST, len(robots) // 2 + 1)].tolist()))


def _membership(population: Population, robot: RobotLikelihood) -> Membership:
    """Membership of a robot in a population."""
    tangent, variance = _seen(population, robot)
    total_square, _ = _distance(population, tangent, variance, np.arange(len(tangent)))
    ratios = {}
    for name, block in population.blocks.items():
        square, directions = _distance(population, tangent, variance, block)
        ratios[name] = square / _limit(population, directions) if directions else 0.0
    unlike = sorted((name for name, ratio in ratios.items() if ratio > 1.0), key=lambda name: -ratios[name])
    return Membership(member=not unlike, distance=float(np.sqrt(total_square)), unlike=tuple(unlike))


def _seen(population: Population, robot: RobotLikelihood) -> tuple[FloatArray, FloatArray]:
    """Tangent coordinates ``(D,)`` of a robot at the mean, from its data and the population; and the covariance
    ``(D, D)`` that such coordinates have among robots of the population."""
    manifold, mean = population.manifold, population.point
    precision = np.linalg.inv(population.covariance)
    point = manifold.point(robot.parameters)
    tangent = manifold.log(mean, point)
    for _ in range(ROUNDS):
        before = tangent
        information, pull = linear(manifold, mean, robot, point)
        posterior = np.linalg.inv(precision + information)
        tangent = posterior @ pull
        if np.max(np.abs(tangent - before)) < SETTLED:
            break
        point = manifold.exp(mean, tangent * min(1.0, LARGEST_STEP / np.max(np.abs(tangent))))
    return tangent, population.covariance - posterior


def _distance(population: Population, tangent: FloatArray, variance: FloatArray, block: IntArray) -> tuple[float, int]:
    """Mean square of the block's coordinates in standard deviations, over the directions that the data identify, and
    the number of these directions."""
    submatrix = np.ix_(block, block)
    whitener = np.linalg.inv(np.linalg.cholesky(population.covariance[submatrix]))
    values, vectors = np.linalg.eigh(whitener @ variance[submatrix] @ whitener.T)
    identified = values > _IDENTIFIED
    if not np.any(identified):
        return 0.0, 0
    along = (vectors.T @ whitener @ tangent[block])[identified]
    return float(np.mean(along**2 / values[identified])), int(np.count_nonzero(identified))


def _limit(population: Population, directions: int) -> float:
    """Mean square that a robot of the population seldom exceeds in any block: Hotelling's, because the covariance is
    estimated."""
    from scipy.stats import f  # noqa: PLC0415 slow to load, and seldom needed

    freedom = max(population.robots + SHARED - directions, 4.0)
    return float(f.isf(_CHANCE_OF_ROBOT / len(population.blocks), directions, freedom))
