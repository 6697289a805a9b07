"""What the joint fit minimises for channels of unknown noise, and the steps in which it does so."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from geomid_ros.estimation.objective import Evaluation, straight_hessian
from geomid_ros.estimation.solvers import Solution, trust_region
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

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
class _Terms:
    """What does not depend on how far the prior is trusted: half of ``sum_c N_c log S_c`` with its slope ``(D,)`` and
    information ``(D, D)``, the logarithm to the prior ``(D,)`` and the Hessian's blocks of half its square."""

    value: float
    slope: FloatArray
    information: FloatArray
    to_prior: FloatArray
    bends: FloatArray


@dataclass(frozen=True, eq=False)
class Profile:
    """Channels of unknown noise: ``products (C, D + 1, D + 1)`` of all columns and the target, ``counts (C,)`` of rows,
    the ``least (C,)`` that a sum of squares may be; and the ``prior``."""

    manifold: ParameterManifold
    products: FloatArray
    counts: FloatArray
    least: FloatArray
    prior: Point
    _known: WeakKeyDictionary[Point, _Terms] = field(default_factory=WeakKeyDictionary, init=False, repr=False)

    @cached_property
    def _flat(self) -> FloatArray:
        """The products ``(C, (D + 1)^2)``."""
        return self.products.reshape(len(self.products), -1)

    def squares(self, point: Point) -> FloatArray:
        """Sums of squares ``(C,)`` of the channels at ``point``, at least ``least (C,)``."""
        vector = np.append(point.parameters, -1.0)
        return np.asarray(np.maximum((self.products @ vector) @ vector, self.least))

    def at(self, point: Point) -> _Terms:
        """The terms at a point, computed once for each point that is in use."""
        if point not in self._known:
            self._known[point] = self._terms(point)
        return self._known[point]

    def _terms(self, point: Point) -> _Terms:
        vector = np.append(point.parameters, -1.0)
        moved = self.products @ vector
        squares = np.maximum(moved @ vector, self.least)
        weights = self.counts / squares
        rows = (weights @ self._flat).reshape(len(vector), -1)
        half = self.manifold.whiten(point, rows[:, :-1])
        return _Terms(
            0.5 * float(self.counts @ np.log(squares)),
            vector @ half,
            self.manifold.whiten(point, half[:-1].T),
            *self.manifold.log_and_hessian(point, self.prior),
        )


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

    def evaluate(self, point: Point) -> Evaluation:
        """Value, gradient, information and Hessian along straight lines at ``point``."""
        terms, links = self.profile.at(point), self.manifold.inertial
        pull = self.weights * terms.to_prior
        value, slope, information = terms.value + 0.5 * float(pull @ terms.to_prior), terms.slope, terms.information
        if len(self.known):
            off = self.known @ np.append(point.parameters - self.profile.prior.parameters, 1.0)
            normals = self.manifold.whiten(point, self.known[:, :-1])
            value, slope = value + 0.5 * float(off @ off), slope + off @ normals
            information = information + normals.T @ normals
        bends = self.weights[links].reshape(-1, terms.bends.shape[-1], 1) * terms.bends
        hessian = straight_hessian(self.manifold, information, self.weights, bends, pull)
        return Evaluation(value, slope - pull, information, hessian)


def minimum(objective: ProfileObjective, start: Point) -> Solution:
    """The minimum that is reached from ``start``, to a twentieth of the parameters' standard deviations."""
    return trust_region(objective, start, max_steps=_STEPS, radius=_RADIUS, least_decrease=_LEAST_DECREASE)
