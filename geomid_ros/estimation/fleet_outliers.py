"""Which robots of a fleet are of one type, and in what others are unlike them.

As by the minimum covariance determinant (Rousseeuw 1984), the population is that of the half that is most alike, and
then, round by round, of all that are no farther from it than such robots are: however many others there are, up to a
half, they do not move it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.population import FEWEST, SHARED, Population, PopulationFit, RobotLikelihood, common, linear
from geomid_ros.estimation.tolerances import LARGEST_STEP, LEAST_DEVIATION, ROUNDS, SETTLED
from geomid_ros.types import FloatArray, IntArray

_CHANCE = 1e-2  # at most, that a robot of the type is taken for another, of all its blocks
_IDENTIFIED = 0.1  # of the variance between robots in a direction that counts, at least, is seen


@dataclass(frozen=True, kw_only=True)
class Membership:
    """How far a robot is from the others of its type.

    Attributes:
        member: whether it is one of them.
        distance: Mahalanobis distance per direction that its data tell, about 1 for a member.
        unlike: the names of links and effects in which it is unlike them, the farthest first.
    """

    member: bool
    distance: float
    unlike: tuple[str, ...]


def population_and_members(robots: Sequence[RobotLikelihood]) -> tuple[Population, list[Membership]]:
    """The population of most of these robots, and who is of it; of few, all are.

    Raises:
        InputError: there are too few, or they have other links.
    """
    shared = common(robots)
    if len(shared) < 2 * FEWEST - 1:  # the half of them is no population
        every = PopulationFit(shared).population
        return every, [Membership(member=True, distance=1.0, unlike=())] * len(shared)
    chosen = _most_alike(shared)
    seen = set()
    while True:
        fit = PopulationFit([shared[index] for index in chosen])
        others = {index: fit.without(place) for place, index in enumerate(chosen)}
        found = [_membership(others.get(index, fit.population), robot) for index, robot in enumerate(shared)]
        inside = tuple(index for index, membership in enumerate(found) if membership.member)
        if inside in seen or len(inside) < FEWEST:
            return fit.population, found
        seen.add(inside)
        chosen = inside


def _most_alike(robots: Sequence[RobotLikelihood]) -> tuple[int, ...]:
    """The half of the robots whose estimates are nearest to the medians."""
    first = robots[0]
    manifold = replace(first.manifold, scales=np.ones(len(first.scales)))
    base = manifold.point(first.prior)
    places = np.array([manifold.log(base, manifold.point(robot.parameters)) for robot in robots])
    off = places - np.median(places, axis=0)
    deviations = np.median(np.abs(off), axis=0) + LEAST_DEVIATION
    nearest = np.argsort(np.mean((off / deviations) ** 2, axis=1), kind="stable")
    return tuple(sorted(nearest[: max(FEWEST, len(robots) // 2 + 1)].tolist()))


def _membership(population: Population, robot: RobotLikelihood) -> Membership:
    """How far a robot is from a population."""
    found, variance = _seen(population, robot)
    whole, _ = _distance(population, found, variance, np.arange(len(found)))
    ratios = {}
    for name, block in population.blocks.items():
        square, directions = _distance(population, found, variance, block)
        ratios[name] = square / _limit(population, directions) if directions else 0.0
    unlike = sorted((name for name, ratio in ratios.items() if ratio > 1.0), key=lambda name: -ratios[name])
    return Membership(member=not unlike, distance=float(np.sqrt(whole)), unlike=tuple(unlike))


def _seen(population: Population, robot: RobotLikelihood) -> tuple[FloatArray, FloatArray]:
    """A robot's tangent coordinates ``(D,)`` at the mean, by its data and the population, and the covariance ``(D, D)``
    that these have among robots of the population."""
    manifold, mean = population.manifold, population.point
    precision = np.linalg.inv(population.covariance)
    point = manifold.point(robot.parameters)
    found = manifold.log(mean, point)
    for _ in range(ROUNDS):
        before = found
        information, pull = linear(manifold, mean, robot, point)
        unsure = np.linalg.inv(precision + information)
        found = unsure @ pull
        if np.max(np.abs(found - before)) < SETTLED:
            break
        point = manifold.exp(mean, found * min(1.0, LARGEST_STEP / np.max(np.abs(found))))
    return found, population.covariance - unsure


def _distance(population: Population, found: FloatArray, variance: FloatArray, block: IntArray) -> tuple[float, int]:
    """Mean square of the block's coordinates in standard deviations, over the directions that the data tell, and how
    many these are."""
    own = np.ix_(block, block)
    whitener = np.linalg.inv(np.linalg.cholesky(population.covariance[own]))
    values, vectors = np.linalg.eigh(whitener @ variance[own] @ whitener.T)
    told = values > _IDENTIFIED
    if not np.any(told):
        return 0.0, 0
    along = (vectors.T @ whitener @ found[block])[told]
    return float(np.mean(along**2 / values[told])), int(np.count_nonzero(told))


def _limit(population: Population, directions: int) -> float:
    """The mean square that a robot of the population seldom exceeds in any block: Hotelling's, as its covariance is
    estimated."""
    from scipy.stats import f  # noqa: PLC0415 takes long to load, and seldom serves

    freedom = max(population.robots + SHARED - directions, 4.0)
    return float(f.isf(_CHANCE / len(population.blocks), directions, freedom))
