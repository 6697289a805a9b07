"""Parameters of links and effects by their names; their joint posterior: a Gaussian in tangent coordinates at the
estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.tolerances import ROUNDING_OF_PRODUCTS
from geomid_ros.geometry import spd, symmetric
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_LEAST = 0.05  # of what the estimate has
_REMEMBERED = 0.01  # of a chain's beginning, as a share of the variance
_MOST_STEPS = 1000


@dataclass(frozen=True, kw_only=True)
class EffectCoordinate:
    """The effect's parameter that a coordinate is: the effect's ``name``, the name of its ``place``, the name of the
    ``parameter`` and its ``unit``; ``positive``: it lives on P(1), else on a real line."""

    name: str
    place: str
    parameter: str
    unit: str
    positive: bool


def effect_columns(names: Iterable[str], first: int) -> dict[str, IntArray]:
    """The columns of each effect at all of its places, by its name, where those of all ``names`` begin at ``first``."""
    every = np.array(list(names))
    return {name: first + np.flatnonzero(every == name) for name in dict.fromkeys(every.tolist())}


def beyond_prior(covariance: FloatArray, spreads: FloatArray) -> FloatArray:
    """What a posterior with this ``covariance (D, D)`` knows beyond a prior with these ``spreads (D,)``.

    Returns:
        ``(D, D)``, a factor F of the information ``F^T F`` on the coordinates in units of the spreads.
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(spreads, spreads))
    beyond = np.sqrt(np.maximum(1.0 / np.maximum(values, ROUNDING_OF_PRODUCTS) - 1.0, 0.0))
    return np.asarray((vectors * beyond).T)


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotParameters:
    """Parameters of links and effects, by their names.

    Attributes:
        links: Names of the moving links.
        effects: The effects' coefficients, the positive ones first.
        parameters: An estimate ``(D,)``: ten per link in pinocchio's order, then the effects' coefficients.
        scales: Of the real coefficients.
    """

    links: tuple[str, ...]
    effects: tuple[EffectCoordinate, ...]
    parameters: FloatArray
    scales: FloatArray

    @cached_property
    def manifold(self) -> ParameterManifold:
        """Where the parameters live."""
        return ParameterManifold(len(self.links), sum(effect.positive for effect in self.effects), self.scales)

    @cached_property
    def point(self) -> Point:
        """The estimate."""
        return self.manifold.point(self.parameters)

    @cached_property
    def blocks(self) -> dict[str, IntArray]:
        """The coordinates of every link, and of every effect at all joints, by name."""
        links = {name: np.arange(10 * index, 10 * index + 10) for index, name in enumerate(self.links)}
        return links | effect_columns((effect.name for effect in self.effects), 10 * len(self.links))

    def columns(self, links: Sequence[str], effects: Sequence[EffectCoordinate]) -> list[int]:
        """Where some of the links and effects stand."""
        first = 10 * len(self.links)
        of_links = (10 * self.links.index(name) + k for name in links for k in range(10))
        return [*of_links, *(first + self.effects.index(effect) for effect in effects)]

    def scales_of(self, effects: Sequence[EffectCoordinate]) -> FloatArray:
        """The scales of those among some of the effects that are real."""
        scales = dict(zip([effect for effect in self.effects if not effect.positive], self.scales, strict=True))
        return frozen([scales[effect] for effect in effects if not effect.positive])


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior(RobotParameters):
    """What is known of all parameters together: ``N(0, covariance)``, given that such a robot can exist.

    Its coordinates ``x (D,)`` are those of the tangent space at the estimate (:mod:`geomid_ros.geometry.manifold`), in
    the order of the parameters, and straight:

    - ten per link, those of the symmetric matrix X of ``P^1/2 (1 + X) P^1/2``, where P is the estimated pseudo-inertia
      ``[[S, h], [h, m]]`` about the link's origin: X11, X22, X33, X44, and sqrt(2) times X12, X13, X14, X23, X24, X34
      (:mod:`geomid_ros.geometry.symmetric`); the body can exist if 1 + X is positive definite;
    - one per positive coefficient c: ``c (1 + x)``, which must be positive;
    - one per real coefficient r with the scale s: ``r + s x``.

    So the parameters are ``estimate + J x`` with a constant J. Geodesics of the same tangents, ``P^1/2 exp(X) P^1/2``,
    would not do: measurements are linear in the parameters, and resolve some of their combinations to 1e-4. A geodesic
    is off a straight line by half of the square of its length: it leaves what was measured long before it is as far as
    other directions are open.

    Attributes:
        merged: The links that are fixed to each of the links and counted in.
        covariance: ``(D, D)`` of the tangent coordinates.
        prior: Parameters ``(D,)`` of the prior that the estimate began with.
        prior_spreads: Standard deviations ``(D,)`` of the prior's error, in tangent coordinates.
    """

    merged: tuple[tuple[str, ...], ...]
    covariance: FloatArray
    prior: FloatArray
    prior_spreads: FloatArray

    @cached_property
    def jacobian(self) -> FloatArray:
        """Derivative ``(D, D)`` of the parameters by the coordinates, block by block."""
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
        """What the data say beyond the prior: rows ``(D, D)`` and targets ``(D,)`` of the parameters, whose errors are
        independent and of standard deviation 1."""
        root = beyond_prior(self.covariance, self.prior_spreads) / self.prior_spreads
        rows = np.asarray(np.linalg.solve(self.jacobian.T, root.T).T, dtype=np.float64)
        return rows, rows @ self.parameters

    def with_effects(self, effects: Sequence[EffectCoordinate]) -> Posterior:
        """The same with the effects in another order, the positive ones first. Raises ValueError if they are others."""
        left = list(enumerate(self.effects))
        places = []
        for effect in effects:
            place = next((place for place, own in left if own == effect), None)
            if place is None:
                raise ValueError(f"it has no {effect.name} of {effect.place}")
            left.remove((place, effect))
            places.append(place)
        if left:
            raise ValueError(f"it has a {left[0][1].name} of {left[0][1].place}")
        first, positive = self.manifold.inertial.stop, len(self.effects) - len(self.scales)
        order = np.concatenate([np.arange(first), first + np.array(places, dtype=np.int64)])
        return replace(
            self,
            effects=tuple(effects),
            parameters=frozen(self.parameters[order]),
            covariance=frozen(self.covariance[np.ix_(order, order)]),
            scales=frozen(self.scales[np.array(places[positive:], dtype=np.int64) - positive]),
            prior=frozen(self.prior[order]),
            prior_spreads=frozen(self.prior_spreads[order]),
        )

    def coordinates(self, parameters: FloatArray) -> FloatArray:
        """The coordinates ``(D,)`` of other parameters ``(D,)``: how far they are from the estimate."""
        return np.asarray(np.linalg.solve(self.jacobian, parameters - self.parameters))

    def draw(self, count: int, random: np.random.Generator, spread: float = 1.0) -> FloatArray:
        """Parameters ``(count, D)`` of robots that are as likely as the posterior says, all of which can exist.

        The Gaussian is cut off where a body would have less than a twentieth of what the estimate has of it in any
        direction, or a positive coefficient of its own: such draws make way for others, by elliptical slice sampling
        (Murray, Adams and MacKay 2010). Directions that the data resolve are as in the Gaussian even so.

        Args:
            count: How many.
            random: The source of chance.
            spread: Factor of all standard deviations.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        root = spread * np.sqrt(np.maximum(values, 0.0)) * vectors

        def gaussian(size: int) -> FloatArray:
            return np.asarray(random.standard_normal((size, len(values))) @ root.T)

        drawn = gaussian(count)
        outside = np.flatnonzero(~self._can_exist(drawn))
        drawn[outside] = self._moved_inside(gaussian, random, len(outside))
        return np.asarray(self.parameters + drawn @ self.jacobian.T)

    def _moved_inside(
        self, gaussian: Callable[[int], FloatArray], random: np.random.Generator, count: int
    ) -> FloatArray:
        """Coordinates ``(count, D)`` of robots that can exist, each by a chain that begins at the estimate."""
        states = np.zeros((count, len(self.parameters)))
        remembered = np.ones(count)
        for _ in range(_MOST_STEPS):
            if np.all(remembered < _REMEMBERED):
                break
            others, angles = gaussian(count), random.uniform(0.0, 2.0 * np.pi, count)
            low, high, left = angles - 2.0 * np.pi, angles.copy(), np.arange(count)
            moved = states.copy()
            while len(left):
                turn = angles[left, None]
                moved[left] = np.cos(turn) * states[left] + np.sin(turn) * others[left]
                left = left[~self._can_exist(moved[left])]
                low[left] = np.where(angles[left] < 0.0, angles[left], low[left])
                high[left] = np.where(angles[left] < 0.0, high[left], angles[left])
                angles[left] = random.uniform(low[left], high[left])
            states = moved
            remembered *= np.cos(angles) ** 2
        return states

    def _can_exist(self, coordinates: FloatArray) -> BoolArray:
        """Which of the robots with these coordinates ``(N, D)`` have bodies and coefficients well above zero."""
        manifold = self.manifold
        links = symmetric.to_matrix(coordinates[:, manifold.inertial].reshape(len(coordinates), -1, symmetric.SIZE))
        possible = spd.is_positive_definite(links + (1.0 - _LEAST) * np.eye(4))
        positive = 1.0 + coordinates[:, manifold.positive] > _LEAST
        return np.asarray(np.all(possible, axis=1) & np.all(positive, axis=1))
