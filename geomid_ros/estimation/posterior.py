"""The joint posterior of links and effects: a Gaussian in the tangent space of the parameters' manifold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class EffectCoordinate:
    """The effect's parameter that a coordinate is: the effect's ``name``, the name of its ``place``, the name of the
    ``parameter`` and its ``unit``; ``positive``: it lives on P(1), else on a real line."""

    name: str
    place: str
    parameter: str
    unit: str
    positive: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior:
    """What is known of all parameters together: ``exp(estimate, N(0, covariance))`` on the manifold.

    Tangent coordinates ``x (D,)`` at the estimate, in the order of the parameters
    (:mod:`geomid_ros.geometry.manifold`):

    - ten per link, those of the symmetric matrix X in ``P^1/2 exp(X) P^1/2``, where P is the estimated pseudo-inertia
      ``[[S, h], [h, m]]`` about the link's origin: X11, X22, X33, X44, and sqrt(2) times X12, X13, X14, X23, X24, X34
      (:mod:`geomid_ros.geometry.symmetric`);
    - one per positive coefficient c: ``c exp(x)``;
    - one per real coefficient r with the scale s: ``r + s x``.

    Whatever x is, the bodies can exist and positive coefficients are positive.

    Attributes:
        links: Names of the moving links.
        merged: The links that are fixed to each of these and counted in.
        effects: The effects' coefficients, the positive ones first.
        parameters: The estimate ``(D,)``: ten per link in pinocchio's order, then the effects' coefficients.
        covariance: ``(D, D)`` of the tangent coordinates.
        scales: Of the real coefficients.
        prior: Parameters ``(D,)`` of the prior that the estimate began with.
        prior_spreads: Standard deviations ``(D,)`` of the prior's error, in tangent coordinates.
    """

    links: tuple[str, ...]
    merged: tuple[tuple[str, ...], ...]
    effects: tuple[EffectCoordinate, ...]
    parameters: FloatArray
    covariance: FloatArray
    scales: FloatArray
    prior: FloatArray
    prior_spreads: FloatArray

    @cached_property
    def manifold(self) -> ParameterManifold:
        """Where the parameters live."""
        return ParameterManifold(len(self.links), sum(effect.positive for effect in self.effects), self.scales)

    @property
    def point(self) -> Point:
        """The estimate."""
        return self.manifold.point(self.parameters)
