"""What the joint fit minimises for channels of unknown noise, and the steps in which it does so."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.objective import Evaluation, with_prior
from geomid_ros.estimation.solvers import Solution, trust_region
from geomid_ros.geometry import compiled
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray, IntArray

_STEPS = 40
_RADIUS = 16.0  # of the first step: as an effect comes or goes, others move as far as it reached
_LEAST_DECREASE = 1e-3  # of half the score


@dataclass(frozen=True, eq=False)
class StraightManifold(ParameterManifold):
    """The manifold with steps along straight lines of the parameters instead of geodesics."""

    def exp(self, base: Point, tangent: FloatArray) -> Point:
        """The end of the straight step that leaves ``base`` with tangent coordinates ``(D,)``."""
        return self.straight(base, tangent)


@dataclass(frozen=True, eq=False)
class Profile:
    """Channels of unknown noise: ``products (C, D + 1, D + 1)`` of all columns and the target, ``counts (C,)`` of rows,
    the ``least (C,)`` that a sum of squares may be; and the ``prior``."""

    manifold: ParameterManifold
    products: FloatArray
    counts: FloatArray
    least: FloatArray
    prior: Point

    def squares(self, point: Point) -> FloatArray:
        """Sums of squares ``(C,)`` of the channels at ``point``, at least ``least (C,)``."""
        return self.weighed(np.append(point.parameters, -1.0))[0]

    def weighed(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums of squares ``(C,)`` at the parameters and -1, ``vector (D + 1,)``, and the sum ``(D + 1, D + 1)`` of the
        products, each with its channel's count over its sum of squares."""
        if compiled.native is None:
            squares = np.maximum((self.products @ vector) @ vector, self.least)
            return squares, np.tensordot(self.counts / squares, self.products, axes=1)
        squares, total = np.empty(len(self.products)), np.empty(self.products.shape[1:])
        compiled.native.weigh(*self._by_channel, vector, self.counts, self.least, squares, total)
        return squares, total

    @cached_property
    def _by_channel(self) -> tuple[FloatArray, IntArray, IntArray]:
        """The products; the columns that each channel has, one channel after the other; and where each channel's end.

        An effort depends only on the links behind its joint, and on the joint's own effects.
        """
        channels, columns = np.nonzero(np.diagonal(self.products, axis1=1, axis2=2))
        ends = np.searchsorted(channels, np.arange(len(self.products)), side="right")
        return np.ascontiguousarray(self.products), columns.copy(), ends


@dataclass(frozen=True, eq=False)
class ProfileObjective:
    """Half of ``sum_c N_c log S_c`` plus the prior's terms, with weights ``(D,)``, equal within a link, of the tangent
    coordinates to it, and with ``known (r, D + 1)`` rows of standard deviation 1, whose last column are their residuals
    at the prior."""

    profile: Profile
    weights: FloatArray
    known: FloatArray

    @property
    def manifold(self) -> ParameterManifold:
        """Where its points live."""
        return self.profile.manifold

    @property
    def scale(self) -> float:
        """Number of all rows."""
        return float(np.sum(self.profile.counts))

    def step(self, point: Point, tangent: FloatArray) -> Point:
        """The end of a step along a straight line."""
        return self.manifold.straight(point, tangent)

    @cached_property
    def _known_products(self) -> FloatArray:
        return self.known.T @ self.known

    def evaluate(self, point: Point) -> Evaluation:
        """Value, gradient, information and Hessian along straight lines at ``point``."""
        profile = self.profile
        vector = np.append(point.parameters, -1.0)
        squares, products = profile.weighed(vector)
        value, slope = 0.5 * float(profile.counts @ np.log(squares)), (products @ vector)[:-1]
        if len(self.known):
            off = self.known @ np.append(point.parameters - profile.prior.parameters, 1.0)
            value, slope = value + 0.5 * float(off @ off), slope + off @ self.known[:, :-1]
            products += self._known_products
        return with_prior(self.manifold, point, profile.prior, self.weights, (value, slope, products))


def minimum(objective: ProfileObjective, start: Point) -> Solution:
    """The minimum that is reached from ``start``, to a twentieth of the parameters' standard deviations."""
    return trust_region(objective, start, max_steps=_STEPS, radius=_RADIUS, least_decrease=_LEAST_DECREASE)
