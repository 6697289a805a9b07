"""Population of the robots of one type: random effects on the manifold.

A robot's parameters are ``exp(m, t)``. The Karcher mean m belongs to the type; the tangent coordinates t are normal
with the covariance S between robots. A robot's rows inform on t; its separate prior does not enter. The URDF is the
prior of the mean, so that directions which no data identify stay as uncertain as they were. Expectation-maximisation
(Dempster, Laird and Rubin 1977; Laird and Ware 1982): the expectation solves for the mean and every robot jointly, with
the rows linearised at each robot; then S is the mean of the expected squares. First S has one variance for all links
and one for each effect. Then it is free, but shrunk towards that: few robots determine no full covariance.
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
from geomid_ros.types import FloatArray, frozen

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
