"""Parameters in which two results differ by more than their uncertainties leave open, and robots of a fleet that are
unlike the others of their type.

Intervals are joint: if the robot is the same, all differences together stay within them with a probability of 95 %.
Each of n comparisons has a share 0.05 / n of the chance to be wrong (Bonferroni), however they depend on each other. A
comparison is that of one number, or that of one link as a whole (:mod:`geomid_ros.estimation.changed_links`).

The errors of both results count as independent. What both took from the same prior counts as uncertain twice.

As by the minimum covariance determinant (Rousseeuw 1984), the population of a fleet is that of the half that is most
alike, and then, round by round, of all that are no farther from it than such robots are: however many others there are,
up to a half, they do not move it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.estimation.changed_links import ChangedLink, LinkEvidence, changed_links
from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.estimation.population import FEWEST, SHARED, Population, PopulationFit, RobotLikelihood, common, linear
from geomid_ros.estimation.tolerances import LARGEST_STEP, LEAST_DEVIATION, ROUNDS, SETTLED
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, UNITS, UncertainInertia
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity
from geomid_ros.types import FloatArray, IntArray

CHANCE = 0.05
"""Probability that any of the numbers is said to differ if none does."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotValues:
    """What a result says of a robot: its ``links`` by name, its ``effects``, and what its data say of all links
    together (None where that is not known)."""

    links: Mapping[str, UncertainInertia]
    effects: tuple[KnownEffect, ...] = ()
    information: LinksInformation | None = None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A number in two results.

    Attributes:
        place: the link or joint, or what else it belongs to.
        effect: the effect whose parameter it is; empty for a link.
        parameter: its name.
        first, second: the two values; None where a result has no such effect: that a model lacks it says nothing of
            the robot.
        half_width: of the joint interval of their difference; NaN where neither result says how sure it is.
    """

    place: str
    effect: str
    parameter: str
    first: Quantity | None
    second: Quantity | None
    half_width: float = math.nan

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return next(value.unit for value in (self.first, self.second) if value is not None)

    @property
    def value(self) -> float:
        """By how much the second value is larger; NaN where one of them is missing."""
        before, after = (math.nan if value is None else value.value for value in (self.first, self.second))
        return after - before

    @property
    def score(self) -> float:
        """The difference in units of its interval: above 1 the two differ."""
        return abs(self.value) / self.half_width if self.half_width > 0.0 else 0.0

    @property
    def differs(self) -> bool:
        """True if the values differ by more than chance explains."""
        return self.score > 1.0

    @property
    def sentence(self) -> str:
        """In words."""
        name = f"{self.effect.replace('_', ' ')} {self.parameter}".strip().replace("_", " ")
        before, after = ("none" if value is None else f"{value.value:.3g}" for value in (self.first, self.second))
        return f"{self.place}: {name} {before} → {after} {self.unit}".strip()


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Two results side by side.

    Attributes:
        differences: every number, in the order of links and effects.
        changed: links whose change explains the difference, the one that explains most first.
        not_compared: links that consist of other parts in the second result.
    """

    differences: tuple[Difference, ...]
    changed: tuple[ChangedLink, ...] = ()
    not_compared: tuple[str, ...] = ()

    @property
    def differing(self) -> list[Difference]:
        """The numbers that differ, the surest first."""
        return sorted((each for each in self.differences if each.differs), key=lambda each: -each.score)


def compared(first: RobotValues, second: RobotValues, chance: float = CHANCE) -> Compared:
    """Compare two results of one robot.

    Args:
        first, second: what they say.
        chance: probability that any number is said to differ if none does.
    """
    common = [name for name in first.links if name in second.links]
    same = [name for name in common if {*first.links[name].merged} == {*second.links[name].merged}]
    differences = [*_links(first, second, same), *_effects(first, second)]
    deviations = [_deviation(difference) for difference in differences]
    evidence = _evidence(first, second, same)
    count = sum(deviation > 0.0 for deviation in deviations) + (len(same) if evidence else 0)
    times, limit = _limits(chance / max(count, 1))
    judged = [
        replace(difference, half_width=times * deviation) if deviation > 0.0 else difference
        for difference, deviation in zip(differences, deviations, strict=True)
    ]
    return Compared(
        differences=tuple(judged),
        changed=changed_links(same, *evidence, limit, -2.0 * math.log(chance)) if evidence else (),
        not_compared=tuple(name for name in common if name not in same),
    )


def _evidence(first: RobotValues, second: RobotValues, names: list[str]) -> tuple[LinkEvidence, LinkEvidence] | None:
    """What the data of both say of these links together; None if either does not say it of exactly these."""
    if first.information is None or second.information is None or not names == [*first.links] == [*second.links]:
        return None
    before, after = (np.array([values.links[name].parameters for name in names]) for values in (first, second))
    return LinkEvidence(before, first.information), LinkEvidence(after, second.information)


def _limits(chance: float) -> tuple[float, float]:
    """Standard deviations of a number, and the gain of a link's change, that chance exceeds with this probability."""
    from scipy.special import chdtri, ndtri  # noqa: PLC0415 of comparisons alone

    return float(-ndtri(0.5 * chance)), float(chdtri(len(QUANTITIES), chance))


def _links(first: RobotValues, second: RobotValues, names: list[str]) -> Iterator[Difference]:
    for name in names:
        pair = [_quantities(values.links[name]) for values in (first, second)]
        for quantity, before, after in zip(QUANTITIES, *pair, strict=True):
            yield Difference(place=name, effect="", parameter=quantity, first=before, second=after)


def _quantities(link: UncertainInertia) -> list[Quantity]:
    return [Quantity(*own) for own in zip(link.quantities.tolist(), link.std.tolist(), UNITS, strict=True)]


def _effects(first: RobotValues, second: RobotValues) -> Iterator[Difference]:
    """Every parameter that either result has."""
    there, here = ({(e.effect, e.link or e.joint): e.parameters for e in values.effects} for values in (first, second))
    for key in dict.fromkeys((*there, *here)):
        before, after = there.get(key, {}), here.get(key, {})
        for name in dict.fromkeys((*before, *after)):
            yield Difference(
                place=key[1], effect=key[0], parameter=name, first=before.get(name), second=after.get(name)
            )


def _deviation(difference: Difference) -> float:
    """Standard deviation of a difference; zero where a value is missing or neither is uncertain. Friction that drifted
    from one motion to the other differs."""
    if difference.first is None or difference.second is None:
        return 0.0
    effect, values = EFFECTS.get(difference.effect), (difference.first, difference.second)
    stds = [value.std if effect is None else effect.within_motion(value) for value in values]
    return math.hypot(*filter(math.isfinite, stds))


_CHANCE_OF_ROBOT = 1e-2  # at most, that a robot of the type is taken for another, of all its blocks
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
    return float(f.isf(_CHANCE_OF_ROBOT / len(population.blocks), directions, freedom))
