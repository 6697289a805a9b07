"""The result of a solve: links and effects with their uncertainty, and how the solver ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, UncertainInertia
from geomid_ros.model.effects import Quantity
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

TOLD = 3.0
"""Standard deviations from nothing at which a quantity, or an effect, is told."""
FINEST = 1e7
"""Inverse of the smallest relative error of an inertia that data are believed to resolve."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkEstimate(UncertainInertia):
    """The identified body of a moving link.

    Attributes:
        name: The moving link.
        distance_from_prior: Geodesic distance.
        min_eigenvalue_ratio: Smallest eigenvalue of ``P0^-1/2 P P0^-1/2``.
        moments: The axes along which the first moment is identified.
        std_doubted: Standard deviations ``(13,)`` of quantities and first moments with a prior that is :func:`doubted`.
        std_prior: The same in the prior, or in the usual one where that is narrower.
        outlier: Whether it left its prior by far more than links usually do: it carries something, or stands in for an
            effect that the model lacks. What the data tell of it is not called identified.
    """

    name: str
    cannot_tell: tuple[str, ...]
    distance_from_prior: float
    min_eigenvalue_ratio: float
    moments: tuple[str, ...]
    std_doubted: FloatArray
    std_prior: FloatArray
    outlier: bool

    @property
    def identified(self) -> tuple[str, ...]:
        """Those of :data:`QUANTITIES` that may be used as numbers of this link."""
        return () if self.outlier else tuple(name for name in QUANTITIES if name not in self.cannot_tell)


def is_told(value: float, deviation: float) -> bool:
    """Whether a quantity is known to a third of itself."""
    return bool(abs(value) > TOLD * deviation)


@dataclass(frozen=True, kw_only=True)
class EffectEstimate:
    """One of an effect's coefficients at a joint, or at another place of that name.

    Attributes:
        name: The effect's.
        joint: The name of its place.
        parameters: The one that the coefficient is, then the effect's constants.
        from_data: Share of the prior's variance that the data removed, 0 to 1.
    """

    name: str
    joint: str
    parameters: Mapping[str, Quantity]
    from_data: float

    @property
    def parameter(self) -> str:
        """The name of the parameter that it is."""
        return next(iter(self.parameters))

    @property
    def value(self) -> float:
        """The parameter's value."""
        return self.parameters[self.parameter].value

    @property
    def std(self) -> float:
        """Its standard deviation."""
        return self.parameters[self.parameter].std

    @property
    def unit(self) -> str:
        """Its unit."""
        return self.parameters[self.parameter].unit


@dataclass(frozen=True, kw_only=True)
class WeighedEstimate:
    """A weighed mass [kg]: the ``given`` one and the estimated ``mass``, each with its standard deviation."""

    name: str
    given: float
    given_std: float
    mass: float
    std: float


@dataclass(frozen=True, eq=False)
class LinksInformation:
    """What the data say of the inertias of all links together, whatever the effects are.

    ``|residuals + rows (x - parameters)|^2`` is minus twice the logarithm of the likelihood of link parameters x, up to
    a constant, maximised over the effects.

    Attributes:
        rows: ``(10 links, 10 links)``, upper triangular.
        residuals: ``(10 links,)``.
    """

    rows: FloatArray
    residuals: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """All that a solve found.

    Attributes:
        converged, reason: Whether the solver converged, and why it stopped.
        seconds, steps: Duration [s] and number of steps.
        gamma: Weight of the prior as a share of the rows'.
        rows_accepted: Rows that were measured and used.
        rows_set_aside: Compressed rows without a projection from the prior; only (19) sets rows aside.
        links, effects, known: The results.
        parameters: ``(D,)`` of the measurement model.
        channels: Names of the measured channels.
        sigmas, rms_nominal, rms: ``(channels,)`` in the channels' units: standard deviations, and RMS residuals of the
            nominal and of the identified model; NaN where nothing was measured.
        spreads: Of the links' priors ``(links,)``, geodesic distances, as found from the data.
        information: What the data say of all links together.
        rows, targets: The same of all parameters of the posterior: rows ``(<= D, D)`` and targets of independent errors
            of standard deviation 1.
        posterior: What is known of links and effects together.
        within: Parameters ``(D,)`` fitted as far as files can hold them, by who reads the file.
        warnings: What makes the result doubtful, in sentences.
    """

    converged: bool
    reason: str
    seconds: float = 0.0
    steps: int
    gamma: float
    rows_accepted: int
    rows_set_aside: int
    links: tuple[LinkEstimate, ...]
    effects: tuple[EffectEstimate, ...]
    parameters: FloatArray
    channels: tuple[str, ...]
    sigmas: FloatArray
    spreads: FloatArray
    rms_nominal: FloatArray
    rms: FloatArray
    information: LinksInformation
    posterior: Posterior
    rows: FloatArray
    targets: FloatArray
    known: tuple[WeighedEstimate, ...] = ()
    within: Mapping[str, FloatArray] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def effort_deviations(model: MeasurementModel, samples: Samples, estimate: Estimate) -> FloatArray:
    """Standard deviations of the efforts that an estimate predicts, as its parameters are unsure together.

    What sensors and the robot do beside the model, ``estimate.sigmas``, is not in them.

    Args:
        model: That the estimate is of.
        samples: N samples.
        estimate: With the parameters and their posterior.

    Returns:
        ``(N, joints)``, NaN for joints whose effort is not measured.
    """
    first = 10 * len(model.identified)
    columns = np.append(np.arange(first), first + np.flatnonzero(estimate.parameters[first:]))  # zero: left out
    deviations = np.full(samples.effort.shape, np.nan)
    efforts = list(model.layout.efforts)
    if efforts:
        rows = model.rows(samples).coefficients[:, efforts][:, :, columns]
        variances = np.sum((rows @ estimate.posterior.parameter_covariance) * rows, axis=2)
        deviations[:] = np.sqrt(np.maximum(variances, 0.0))
    return deviations
