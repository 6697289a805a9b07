"""Find the links that have changed between two results, by the likelihoods of all links together.

Single inertial parameters are mostly known in combinations only: a mass that changed by a fifth may lie within the
interval of each number. Here the links are the same robot's in both results, except for those that changed. Both
log-likelihoods are functions of the link parameters. The change of one link is tested by how much better it explains
the difference, -2 log p. If nothing has changed, this is chi-square distributed with at most ten degrees of freedom.
Links are added one by one, the best first (stepwise), until no other explains more than chance. The effects are
eliminated: friction may differ from day to day.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.estimation.uncertain_inertia import STDS_OF_95
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.geometry.pseudo_inertia import SIZE
from geomid_ros.model.effects import Quantity
from geomid_ros.types import FloatArray

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
    while len(changed) < len(names):
        remaining = [link for link in range(len(names)) if link not in changed]
        errors = {link: problem.solved([*changed, link])[0] for link in remaining}
        best = min(remaining, key=errors.__getitem__)
        gain = problem.solved(changed)[0] - errors[best]
        if gain <= limit:
            break
        rivals = [names[link] for link in remaining if link != best and errors[link] - errors[best] < alike]
        changed.append(best)
        gains.append((gain, rivals))
    return tuple(
        ChangedLink(names[link], gain, mass, dict(zip("xyz", moment, strict=True)), tuple(rivals))
        for link, (gain, rivals), (mass, *moment) in zip(changed, gains, problem.sizes(changed), strict=True)
    )


@dataclass(frozen=True, eq=False)
class _LinkChanges:
    """Least squares in tangent coordinates at the first result, for its links and the changes of some of them. The
    prior std of a coordinate is 1: a change of the size of the body itself."""

    first: LinkEvidence
    second: LinkEvidence

    @cached_property
    def _jacobian(self) -> FloatArray:
        """Derivative ``(links, 10, 10)`` of each link's parameters by its coordinates."""
        manifold = ParameterManifold(len(self.first.parameters), 0, np.zeros(0))
        return manifold.point(self.first.parameters.ravel()).links_jacobian

    @cached_property
    def _whitened(self) -> list[tuple[FloatArray, FloatArray]]:
        """Per result, rows ``(10 links, 10 links)`` of the coordinates, and residuals at the first result."""
        both = []
        for evidence in (self.first, self.second):
            rows, offset = evidence.information.rows, (self.first.parameters - evidence.parameters).ravel()
            blocks = np.einsum("nli,lij->nlj", rows.reshape(len(rows), -1, SIZE), self._jacobian)
            both.append((blocks.reshape(rows.shape), evidence.information.residuals + rows @ offset))
        return both

    def solved(self, changed: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Least squared error if these links have changed, their changes ``(10 changed,)`` in coordinates, and the
        covariance of the changes."""
        (before, residual), (after, other) = self._whitened
        columns = [SIZE * link + index for link in changed for index in range(SIZE)]
        size = before.shape[1]
        unchanged = np.column_stack([before, np.zeros((len(before), len(columns)))])
        prior = np.eye(size + len(columns))
        rows = np.concatenate([unchanged, np.column_stack([after, after[:, columns]]), prior])
        targets = np.concatenate([-residual, -other, np.zeros(len(prior))])
        orthogonal, triangle = np.linalg.qr(rows)
        projected = orthogonal.T @ targets
        inverse = np.linalg.inv(triangle)
        covariance = inverse @ inverse.T
        solution = inverse @ projected
        return float(np.sum((targets - rows @ solution) ** 2)), solution[size:], covariance[size:, size:]

    def sizes(self, changed: Sequence[int]) -> list[list[Quantity]]:
        """Increases of mass and first moment of each changed link."""
        _, changes, covariance = self.solved(changed)
        increases = []
        for place, link in enumerate(changed):
            block, rows = slice(SIZE * place, SIZE * (place + 1)), self._jacobian[link][: len(_UNITS)]
            std = np.sqrt(np.diag(rows @ covariance[block, block] @ rows.T))
            values = (rows @ changes[block]).tolist()
            increases.append([Quantity(*entry) for entry in zip(values, std.tolist(), _UNITS, strict=True)])
        return increases
