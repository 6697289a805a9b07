"""Parts that are alike: their errors have a part in common, of the usual size, and one of their own, a fifth of it.

With the tangent coordinates d_i of n links at their priors, mirrored to those of the first, the covariance of the
errors is ``s^2 (1 1^T + I / 25)``. That is, but for a hundredth, a prior of each link alone of spread ``s sqrt(n)``,
and rows that hold the links to their mean. A link that is unlike the others is let go alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.coupled_prior import DOUBTED, CoupledPrior
from geomid_ros.estimation.link_spreads import CERTAINTY
from geomid_ros.estimation.problem import Problem
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.symmetric import SIZE
from geomid_ros.model.alike_parts import OWN_SPREAD, AlikeParts
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class AlikePrior(CoupledPrior):
    """Groups of ``parts`` that are alike."""

    parts: Sequence[AlikeParts]

    @staticmethod
    def of(parts: Sequence[AlikeParts], problem: Problem) -> AlikePrior:
        """The prior of a problem whose links have those of the URDF."""
        spreads = problem.usual.copy()
        for group in parts:
            spreads[list(group.members)] *= np.sqrt(len(group.members))
        columns = np.arange(problem.manifold.inertial.stop)
        return AlikePrior(replace(problem, given_spreads=spreads), columns, parts)

    @cached_property
    def manifold(self) -> ParameterManifold:
        """That of the links."""
        return ParameterManifold(self.problem.manifold.links, 0, np.zeros(0))

    @cached_property
    def mean(self) -> Point:
        """The links' priors."""
        return self.manifold.point(self.problem.prior[self.columns])

    @property
    def names(self) -> tuple[str, ...]:
        """The links that are alike to others."""
        return tuple(name for group in self.parts for name in group.names)

    @property
    def freedom(self) -> float:
        """That of the usual spread of a link."""
        return CERTAINTY

    def root(self, weights: Mapping[str, float]) -> FloatArray:
        """Of each link in units of its own error."""
        return np.concatenate([weights[name] ** 0.5 * self.off(name, weights) for name in self.names])

    def off(self, name: str, weights: Mapping[str, float], /) -> FloatArray:
        """Of a link from the mean of those that are alike, which counts them by their weights."""
        group = next(group for group in self.parts if name in group.names)
        shares = np.array([weights[other] for other in group.names])
        factors = np.array([float(other == name) for other in group.names]) - shares / np.sum(shares)
        rows = np.zeros((SIZE, len(self.columns)))
        for factor, member, signs in zip(factors, group.members, group.signs, strict=True):
            rows[:, self.manifold.link(member)] = factor / OWN_SPREAD * np.diag(signs)
        return rows

    def unlike(self, weights: Mapping[str, float]) -> Iterator[str]:
        """A sentence for each link that is unlike the others."""
        for group in self.parts:
            for name in group.names:
                if weights[name] < DOUBTED:
                    others = ", ".join(other for other in group.names if other != name)
                    yield (
                        f"link '{name}' differs from {others}, which are the same part by the URDF, and was released "
                        "from them; check for a repair or a load on it, or give '--alike none'"
                    )
