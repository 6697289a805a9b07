"""What robots of a type have in common."""

from __future__ import annotations

from dataclasses import dataclass

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """What one robot's data say of its parameters, without any prior.

    Attributes:
        links: names of the moving links.
        effects: the effects' coefficients, the positive ones first.
        rows, targets: ``(N, D)`` and ``(N,)``: ``rows . parameters = targets`` with independent errors of standard
            deviation 1.
        parameters: the robot's estimate ``(D,)``.
        prior: the parameters ``(D,)`` that its estimate began with.
        scales: of the real coefficients.
    """

    links: tuple[str, ...]
    effects: tuple[EffectCoordinate, ...]
    rows: FloatArray
    targets: FloatArray
    parameters: FloatArray
    prior: FloatArray
    scales: FloatArray

    @staticmethod
    def of(estimate: Estimate) -> Evidence:
        """Of an estimate."""
        posterior = estimate.posterior
        return Evidence(
            links=posterior.links,
            effects=posterior.effects,
            rows=estimate.rows,
            targets=estimate.targets,
            parameters=posterior.parameters,
            prior=posterior.prior,
            scales=posterior.scales,
        )
