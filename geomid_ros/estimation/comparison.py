"""Compare two results of one robot, and find robots of a fleet that are unlike the others of their type.

Intervals are joint: if the robot is the same, all differences together stay within them with a probability of 95 %.
Each of n comparisons gets a fraction 0.05 / n of the error probability (Bonferroni), however they depend on each other.
A comparison is of one number, or of one link as a whole (:mod:`geomid_ros.estimation.changed_links`).

The errors of both results count as independent. An error from a common prior therefore counts twice.

Following the minimum covariance determinant (Rousseeuw 1984), the population of a fleet is that of the most alike half.
Then, round by round, it includes all robots that are no farther from it than members are. So the others do not move it,
as long as they are less than half.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.changed_links import ChangedLink, LinkEvidence, changed_links
from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.estimation.population import (
    FEWEST,
    SHARED,
    Population,
    PopulationFit,
    RobotLikelihood,
    common_likelihoods,
    linear,
)
from geomid_ros.estimation.tolerances import LARGEST_STEP, LEAST_DEVIATION, ROUNDS, SETTLED
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, UNITS, UncertainInertia
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity
from geomid_ros.types import FloatArray, IntArray

CHANCE = 0.05
"""Probability that any number is reported to differ if none does."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotValues:
    """Values of a result: its ``links`` by name, its ``effects``, and the log-likelihood of all links together (None if
    unknown)."""

    links: Mapping[str, UncertainInertia]
    effects: tuple[KnownEffect, ...] = ()
    information: LinksInformation | None = None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A number in two results.

    Attributes:
        place: name of the link, joint or other place.
        effect: name of the effect; empty for a link.
        parameter: name of the parameter.
        first, second: the two values; None if a result has no such effect, which does not mean that the robot lacks it.
        half_width: half-width of the joint interval of their difference; NaN if one is missing or neither is uncertain.
    """

    place: str
    effect: str
    parameter: str
    first: Quantity | None
    second: Quantity | None
    half_width: float = math.nan

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return next(value.unit for value in (self.first, self.second) if value is not None)

    @property
    def value(self) -> float:
        """Second value minus the first; NaN if one of them is missing."""
        before, after = (math.nan if value is None else value.value for value in (self.first, self.second))
        return after - before

    @property
    def score(self) -> float:
        """Absolute difference in units of its half-width: above 1 the two differ."""
        return abs(self.value) / self.half_width if self.half_width > 0.0 else 0.0

    @property
    def differs(self) -> bool:
        """True if the values differ by more than chance explains."""
        return self.score > 1.0

    @property
    def sentence(self) -> str:
        """Sentence for reports."""
        name = f"{self.effect.replace('_', ' ')} {self.parameter}".strip().replace("_", " ")
        before, after = ("absent" if value is None else f"{value.value:.3g}" for value in (self.first, self.second))
        return f"{self.place}: {name} {before} → {after} {self.unit}".strip()


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Comparison of two results.

    Attributes:
        differences: all numbers, in the order of links and effects.
        changed: links whose change explains the difference, the one that explains most first.
        not_compared: links that consist of different parts in the second result.
    """

    differences: tuple[Difference, ...]
    changed: tuple[ChangedLink, ...] = ()
    not_compared: tuple[str, ...] = ()

    @property
    def differing(self) -> list[Difference]:
        """Numbers that differ, the most significant first."""
        return sorted((item for item in self.differences if item.differs), key=lambda item: -item.score)


def compare_robots(first: RobotValues, second: RobotValues, chance: float = CHANCE) -> Compared:
    """Compare two results of one robot.

    Args:
        first, second: the two results.
        chance: probability that any number is reported to differ if none does.
    """
    common = [name for name in first.links if name in second.links]
    same = [name for name in common if {*first.links[name].merged} == {*second.links[name].merged}]
    differences = [*_links(first, second, same), *_effects(first, second)]
    deviations = [_deviation(difference) for difference in differences]
    evidence = _evidence(first, second, same)
    count = sum(deviation > 0.0 for deviation in deviations) + (len(same) if evidence else 0)
    factor, limit = _limits(chance / max(count, 1))
    with_widths = [
        replace(difference, half_width=factor * deviation) if deviation > 0.0 else difference
        for difference, deviation in zip(differences, deviations, strict=True)
    ]
    return Compared(
        differences=tuple(with_widths),
        changed=changed_links(same, *evidence, limit, -2.0 * math.log(chance)) if evidence else (),
        not_compared=tuple(name for name in common if name not in same),
    )


def _evidence(first: RobotValues, second: RobotValues, names: list[str]) -> tuple[LinkEvidence, LinkEvidence] | None:
    """Likelihoods of these links from both results; None if either has none for exactly these."""
    if first.information is None or second.information is None or not names == [*first.links] == [*second.links]:
        return None
    before, after = (np.array([values.links[name].parameters for name in names]) for values in (first, second))
    return LinkEvidence(before, first.information), LinkEvidence(after, second.information)


def _limits(chance: float) -> tuple[float, float]:
    """Thresholds that chance exceeds with this probability: a difference in stds, the gain of a link's change."""
    from scipy.special import chdtri, ndtri  # noqa: PLC0415 only comparisons need it

    return float(-ndtri(0.5 * chance)), float(chdtri(len(QUANTITIES), chance))


def _links(first: RobotValues, second: RobotValues, names: list[str]) -> Iterator[Difference]:
    for name in names:
        links = (first.links[name], second.links[name])
        numbers = [zip(link.quantities.tolist(), link.std.tolist(), UNITS, strict=True) for link in links]
        for parameter, *pair in zip(QUANTITIES, *numbers, strict=True):
            before, after = (Quantity(*entry) for entry in pair)
            yield Difference(place=name, effect="", parameter=parameter, first=before, second=after)


def _effects(first: RobotValues, second: RobotValues) -> Iterator[Difference]:
    """Yield every parameter that either result has."""
    firsts, seconds = ({(e.effect, e.link or e.joint): e.parameters for e in r.effects} for r in (first, second))
    for key in dict.fromkeys((*firsts, *seconds)):
        before, after = firsts.get(key, {}), seconds.get(key, {})
        for name in dict.fromkeys((*before, *after)):
            yield Difference(
                place=key[1], effect=key[0], parameter=name, first=before.get(name), second=after.get(name)
            )


def _deviation(difference: Difference) -> float:
    """Standard deviation of a difference; zero if a value is missing or neither is uncertain. Drift between motions is
    excluded: friction that drifted differs."""
    if difference.first is None or difference.second is None:
        return 0.0
    effect, values = EFFECTS.get(difference.effect), (difference.first, difference.second)
    stds = [value.std if effect is None else effect.within_motion(value) for value in values]
    return math.hypot(*filter(math.isfinite, stds))


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
