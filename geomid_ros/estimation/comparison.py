"""Compare two results of one robot: every number, and which links have changed.

Intervals are joint: if the robot is the same, all differences together stay within them with a probability of 95 %.
Each of n comparisons gets a fraction 0.05 / n of the error probability (Bonferroni), however they depend on each other.
A comparison is of one number, or of one link as a whole (:func:`changed_links`).

The errors of both results count as independent. An error from a common prior therefore counts twice.

Single inertial parameters are mostly known in combinations only: a mass that changed by a fifth may lie within the
interval of each number. Here the links are the same robot's in both results, except for those that changed. Both
log-likelihoods are functions of the link parameters. The change of one link is tested by how much better it explains
the difference, -2 log p. If nothing has changed, this is chi-square distributed with at most ten degrees of freedom.
Links are added one by one, the best first (stepwise), until no other explains more than chance. No model follows what a
changed link adds to the efforts exactly: a tenth of it counts as an error, spread over all directions in which the
results can contradict each other. The effects are eliminated: friction may differ from day to day.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.estimate import LACKING, QUANTITIES, STDS_OF_95, UNITS, LinksInformation, UncertainInertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.geometry.pseudo_inertia import SIZE
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity
from geomid_ros.types import FloatArray

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
    firsts, seconds = ({(e.effect, e.location): e.parameters for e in r.effects} for r in (first, second))
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


_UNITS = ("kg", "kg m", "kg m", "kg m")  # of mass and first moment, the first parameters


@dataclass(frozen=True)
class ChangedLink:
    """A link whose change explains the difference of two results.

    Attributes:
        link: name of the link.
        gain: decrease of -2 log p by its change.
        mass: increase of its mass in the second result [kg].
        moment: increase of its first moment about the link's origin, by axis [kg m].
        rivals: links whose change explains it nearly as well.
    """

    link: str
    gain: float
    mass: Quantity
    moment: Mapping[str, Quantity] = field(default_factory=dict)
    rivals: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence with 95 % intervals: the mass, or if its change is not significant, the first moment."""
        others = f", or {' or '.join(self.rivals)} changed instead" if self.rivals else ""
        mass = f"by {_with_interval(self.mass)} kg"
        if _is_significant(self.mass):
            return f"mass of {self.link} changed {mass}{others}"
        moments = [
            f"first moment {axis} by {_with_interval(change)} kg m"
            for axis, change in self.moment.items()
            if _is_significant(change)
        ]
        return f"{self.link} changed: {', '.join([*moments, f'mass {mass}'])}{others}"


def _with_interval(change: Quantity) -> str:
    """Format a change with its sign and 95 % interval, without the unit."""
    return f"{change.value:+.3g} ± {STDS_OF_95 * change.std:.2g}"


def _is_significant(change: Quantity) -> bool:
    """True if a change differs from zero by its 95 % interval."""
    return abs(change.value) > STDS_OF_95 * change.std


@dataclass(frozen=True, eq=False)
class LinkEvidence:
    """Likelihood of a result's links.

    Attributes:
        parameters: ``(links, 10)`` in pinocchio's order, about the links' origins.
        information: the log-likelihood about these.
    """

    parameters: FloatArray
    information: LinksInformation


def changed_links(
    names: Sequence[str], first: LinkEvidence, second: LinkEvidence, limit: float, alike: float
) -> tuple[ChangedLink, ...]:
    """Find the links that have changed, in the order of detection.

    Args:
        names: names of the links.
        first, second: both results, links in the order of the names.
        limit: gain above which a change is significant.
        alike: a link is a rival if its change explains the difference worse by less than this.
    """
    problem = _LinkChanges(first, second)
    changed: list[int] = []
    gains: list[tuple[float, list[str]]] = []
    inflation = 1.0
    while len(changed) < len(names):
        remaining = [link for link in range(len(names)) if link not in changed]
        errors = {link: problem.solved([*changed, link])[0] for link in remaining}
        best = min(remaining, key=errors.__getitem__)
        gain = problem.solved(changed)[0] - errors[best]
        if gain <= inflation * limit:
            break
        rivals = [names[link] for link in remaining if link != best and errors[link] - errors[best] < alike]
        changed.append(best)
        gains.append((gain, rivals))
        inflation += LACKING**2 * gain / problem.contradictions
    return tuple(
        ChangedLink(names[link], gain, mass, dict(zip("xyz", moment, strict=True)), tuple(rivals))
        for link, (gain, rivals), (mass, *moment) in zip(changed, gains, problem.sizes(changed, inflation), strict=True)
    )


@dataclass(frozen=True, eq=False)
class _LinkChanges:
    """Least squares for the links and the changes of some of them. The prior std is 1 in tangent coordinates: at the
    first result for the links, and at the mean of both for a change. It may be far larger than the link was, as a
    payload on a wrist is, but a link loses no more than it has."""

    first: LinkEvidence
    second: LinkEvidence

    @cached_property
    def _jacobians(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives ``(links, 10, 10)`` of each link's parameters by its coordinates, and by those of its change."""
        before, after = self.first.parameters, self.second.parameters
        manifold = ParameterManifold(len(before), 0, np.zeros(0))
        links, changes = (manifold.point(bodies.ravel()).links_jacobian for bodies in (before, 0.5 * (before + after)))
        return links, changes

    @cached_property
    def _whitened(self) -> list[tuple[FloatArray, FloatArray]]:
        """Per result, rows ``(10 links, 10 links)`` of the coordinates, and residuals at the first result."""
        both = []
        for evidence in (self.first, self.second):
            offset = (self.first.parameters - evidence.parameters).ravel()
            information = evidence.information
            rows = _by_links(information.rows, self._jacobians[0])
            both.append((rows, information.residuals + information.rows @ offset))
        return both

    @cached_property
    def contradictions(self) -> float:
        """Number of directions in which the results can contradict each other: those that both determine."""
        first, second = (rows.T @ rows for rows, _ in self._whitened)
        unknown = [
            float(np.trace(np.linalg.inv(np.eye(len(known)) + known))) for known in (first, second, first + second)
        ]
        return len(first) + unknown[2] - unknown[0] - unknown[1]

    def solved(self, changed: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Least squared error if these links have changed, their changes ``(10 changed,)`` in coordinates, and the
        covariance of the changes."""
        (before, residual), (after, other) = self._whitened
        columns = [SIZE * link + index for link in changed for index in range(SIZE)]
        size = before.shape[1]
        unchanged = np.column_stack([before, np.zeros((len(before), len(columns)))])
        prior = np.eye(size + len(columns))
        changes = _by_links(self.second.information.rows, self._jacobians[1])[:, columns]
        rows = np.concatenate([unchanged, np.column_stack([after, changes]), prior])
        targets = np.concatenate([-residual, -other, np.zeros(len(prior))])
        orthogonal, triangle = np.linalg.qr(rows)
        projected = orthogonal.T @ targets
        inverse = np.linalg.inv(triangle)
        covariance = inverse @ inverse.T
        solution = inverse @ projected
        return float(np.sum((targets - rows @ solution) ** 2)), solution[size:], covariance[size:, size:]

    def sizes(self, changed: Sequence[int], inflation: float) -> list[list[Quantity]]:
        """Increases of mass and first moment of each changed link; ``inflation``: factor of all variances."""
        _, changes, covariance = self.solved(changed)
        increases = []
        for place, link in enumerate(changed):
            block, rows = slice(SIZE * place, SIZE * (place + 1)), self._jacobians[1][link][: len(_UNITS)]
            std = np.sqrt(inflation * np.diag(rows @ covariance[block, block] @ rows.T))
            values = (rows @ changes[block]).tolist()
            increases.append([Quantity(*entry) for entry in zip(values, std.tolist(), _UNITS, strict=True)])
        return increases


def _by_links(rows: FloatArray, jacobians: FloatArray) -> FloatArray:
    """Rows ``(N, 10 links)`` by the links' coordinates; ``jacobians (links, 10, 10)``."""
    return np.asarray(rows.reshape(len(rows), -1, 1, SIZE) @ jacobians).reshape(rows.shape)
