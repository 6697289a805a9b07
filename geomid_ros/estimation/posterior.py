"""Named parameters of links and effects, and their joint posterior: a Gaussian in tangent coordinates at the
estimate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING_OF_PRODUCTS
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_LEAST = 0.05  # fraction of the estimate's inertia in any direction, or coefficient, that a sampled robot has at least
_REMEMBERED = 0.01  # fraction of a chain's variance due to its start, below which the chain ends
_MOST_STEPS = 1000


@dataclass(frozen=True, kw_only=True)
class EffectCoordinate:
    """Coordinate that is a parameter of an effect: the effect's ``name``, the name of its ``place``, the ``parameter``
    and its ``unit``; ``positive``: True if it lives on P(1), else on a real line."""

    name: str
    place: str
    parameter: str
    unit: str
    positive: bool


def effect_columns(names: Iterable[str], first: int) -> dict[str, IntArray]:
    """Columns of each effect at all of its places, by name; the columns of ``names`` start at ``first``."""
    all_names = np.array(list(names))
    return {name: first + np.flatnonzero(all_names == name) for name in dict.fromkeys(all_names.tolist())}


def beyond_prior(covariance: FloatArray, prior_stds: FloatArray) -> FloatArray:
    """Information of a posterior with this ``covariance (D, D)`` beyond that of a prior with stds ``prior_stds (D,)``.

    Returns:
        ``(D, D)``, a factor F of the information ``F^T F`` on the coordinates in units of the prior std.
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(prior_stds, prior_stds))
    beyond = np.sqrt(np.maximum(1.0 / np.maximum(values, ROUNDING_OF_PRODUCTS) - 1.0, 0.0))
    return np.asarray((vectors * beyond).T)


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotParameters:
    """Parameters of links and effects, with their names.

    Attributes:
        links: Names of the moving links.
        effects: The effects' coefficients, the positive ones first.
        parameters: An estimate ``(D,)``: ten per link in pinocchio's order, then the effects' coefficients.
        scales: Scales of the real coefficients.
    """

    links: tuple[str, ...]
    effects: tuple[EffectCoordinate, ...]
    parameters: FloatArray
    scales: FloatArray

    @cached_property
    def manifold(self) -> ParameterManifold:
        """Manifold of the parameters."""
        return ParameterManifold(len(self.links), sum(effect.positive for effect in self.effects), self.scales)

    @cached_property
    def point(self) -> Point:
        """Point of the estimate."""
        return self.manifold.point(self.parameters)

    @cached_property
    def blocks(self) -> dict[str, IntArray]:
        """Coordinates of each link, and of each effect at all joints, by name."""
        links = {name: np.arange(10 * index, 10 * index + 10) for index, name in enumerate(self.links)}
        return links | effect_columns((effect.name for effect in self.effects), 10 * len(self.links))

    def columns(self, links: Sequence[str], effects: Sequence[EffectCoordinate]) -> list[int]:
        """Columns of some of the links and effects."""
        first = 10 * len(self.links)
        link_columns = (10 * self.links.index(name) + k for name in links for k in range(10))
        return [*link_columns, *(first + self.effects.index(effect) for effect in effects)]

    def _part(self, links: Sequence[str], effects: Sequence[EffectCoordinate], **changes: FloatArray) -> Self:
        """Parameters of some links and effects, in the given order, with other ``changes`` of attributes."""
        scales = dict(zip([effect for effect in self.effects if not effect.positive], self.scales, strict=True))
        return replace(
            self,
            links=tuple(links),
            effects=tuple(effects),
            parameters=frozen(self.parameters[self.columns(links, effects)]),
            scales=frozen([scales[effect] for effect in effects if not effect.positive]),
            **changes,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior(RobotParameters):
    """Joint posterior of all parameters: ``N(0, covariance)``, given that the robot is physically consistent.

    Its coordinates ``x (D,)`` are those of the tangent space at the estimate (:mod:`geomid_ros.geometry.manifold`), in
    the order of the parameters, and straight:

    - ten per link, those of the symmetric matrix X of ``P^1/2 (1 + X) P^1/2``, where P is the estimated pseudo-inertia
      ``[[S, h], [h, m]]`` about the link's origin: X11, X22, X33, X44, and sqrt(2) times X12, X13, X14, X23, X24, X34
      (:mod:`geomid_ros.geometry.spd`); the body is physically consistent if 1 + X is positive definite;
    - one per positive coefficient c: ``c (1 + x)``, which must be positive;
    - one per real coefficient r with the scale s: ``r + s x``.

    So the parameters are ``estimate + J x`` with a constant J. Geodesics of the same tangents, ``P^1/2 exp(X) P^1/2``,
    would not do: measurements are linear in the parameters, and resolve some of their combinations to 1e-4. A geodesic
    deviates from a straight line by half of the square of its length. So it contradicts the measurements long before it
    reaches the uncertainty of the other directions.

    Attributes:
        merged: Links that are fixed to each of the links and included in it.
        covariance: ``(D, D)`` of the tangent coordinates.
        prior: Parameters ``(D,)`` of the prior that the estimate started from.
        prior_stds: Standard deviations ``(D,)`` of the prior's error, in tangent coordinates.
    """

    merged: tuple[tuple[str, ...], ...]
    covariance: FloatArray
    prior: FloatArray
    prior_stds: FloatArray

    @cached_property
    def jacobian(self) -> FloatArray:
        """Derivative ``(D, D)`` of the parameters by the coordinates, block-diagonal."""
        blocks, diagonal = self.manifold.jacobian(self.point)
        jacobian = np.diag(np.concatenate([np.zeros(self.manifold.inertial.stop), diagonal]))
        jacobian[self.manifold.links_blocks] = blocks
        return frozen(jacobian)

    @cached_property
    def parameter_covariance(self) -> FloatArray:
        """Covariance ``(D, D)`` of the parameters themselves, in their units."""
        return frozen(self.jacobian @ self.covariance @ self.jacobian.T)

    @property
    def evidence(self) -> tuple[FloatArray, FloatArray]:
        """Information of the data beyond the prior: rows ``(D, D)`` and targets ``(D,)`` of the parameters, with
        independent errors of standard deviation 1."""
        root = beyond_prior(self.covariance, self.prior_stds) / self.prior_stds
        rows = np.asarray(np.linalg.solve(self.jacobian.T, root.T).T, dtype=np.float64)
        return rows, rows @ self.parameters

    def with_effects(self, effects: Sequence[EffectCoordinate]) -> Posterior:
        """Return it with the effects in another order, the positive ones first. Raises ValueError for other effects."""
        wanted, present = Counter(effects), Counter(self.effects)
        for effect in wanted - present:
            raise ValueError(f"it has no {effect.name} of {effect.place}")
        for effect in present - wanted:
            raise ValueError(f"it has a {effect.name} of {effect.place}")
        order = self.columns(self.links, effects)
        covariance, prior = frozen(self.covariance[np.ix_(order, order)]), frozen(self.prior[order])
        return self._part(
            self.links, effects, covariance=covariance, prior=prior, prior_stds=frozen(self.prior_stds[order])
        )

    def coordinates(self, parameters: FloatArray) -> FloatArray:
        """Coordinates ``(D,)`` of other parameters ``(D,)``: their offset from the estimate."""
        return np.asarray(np.linalg.solve(self.jacobian, parameters - self.parameters))

    def draw(self, count: int, random: np.random.Generator, std_factor: float = 1.0) -> FloatArray:
        """Sample parameters ``(count, D)`` of robots from the posterior; all are physically consistent.

        The Gaussian is cut off where, in any direction, a body would have less than a twentieth of the estimate's
        inertia, or a positive coefficient less than a twentieth of its value. Such samples are replaced by elliptical
        slice sampling (Murray, Adams and MacKay 2010). Directions that the data resolve keep the Gaussian distribution.

        Args:
            count: Number of robots.
            random: Random number generator.
            std_factor: Factor of all standard deviations.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        root = std_factor * np.sqrt(np.maximum(values, 0.0)) * vectors

        def gaussian(size: int) -> FloatArray:
            return np.asarray(random.standard_normal((size, len(values))) @ root.T)

        drawn = gaussian(count)
        outside = np.flatnonzero(~self._can_exist(drawn))
        drawn[outside] = self._moved_inside(gaussian, random, len(outside))
        return np.asarray(self.parameters + drawn @ self.jacobian.T)

    def _moved_inside(
        self, gaussian: Callable[[int], FloatArray], random: np.random.Generator, count: int
    ) -> FloatArray:
        """Coordinates ``(count, D)`` of physically consistent robots, each from a chain that starts at the estimate."""
        states = np.zeros((count, len(self.parameters)))
        remembered = np.ones(count)
        for _ in range(_MOST_STEPS):
            if np.all(remembered < _REMEMBERED):
                break
            others, angles = gaussian(count), random.uniform(0.0, 2.0 * np.pi, count)
            low, high, outside = angles - 2.0 * np.pi, angles.copy(), np.arange(count)
            moved = states.copy()
            while len(outside):
                turn = angles[outside, None]
                moved[outside] = np.cos(turn) * states[outside] + np.sin(turn) * others[outside]
                outside = outside[~self._can_exist(moved[outside])]
                low[outside] = np.where(angles[outside] < 0.0, angles[outside], low[outside])
                high[outside] = np.where(angles[outside] < 0.0, high[outside], angles[outside])
                angles[outside] = random.uniform(low[outside], high[outside])
            states = moved
            remembered *= np.cos(angles) ** 2
        return states

    def _can_exist(self, coordinates: FloatArray) -> BoolArray:
        """True for robots whose bodies and positive coefficients are well above zero, for coordinates ``(N, D)``."""
        manifold = self.manifold
        matrices = spd.to_matrix(coordinates[:, manifold.inertial].reshape(len(coordinates), -1, spd.SIZE))
        possible = spd.is_positive_definite(matrices + (1.0 - _LEAST) * np.eye(4))
        positive = 1.0 + coordinates[:, manifold.positive] > _LEAST
        return np.asarray(np.all(possible, axis=1) & np.all(positive, axis=1))
