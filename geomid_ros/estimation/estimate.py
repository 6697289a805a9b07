"""Result of a solve: links and effects with their uncertainty, and how the solver ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, UncertainInertia
from geomid_ros.model.effects import Quantity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

SIGNIFICANT_STDS = 3.0
"""Ratio of a quantity or effect to its standard deviation from which it is significant."""
FINEST = 1e7
"""Inverse of the smallest relative error of an inertia that data can resolve."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkEstimate(UncertainInertia):
    """Identified inertia of a moving link.

    Attributes:
        name: Name of the link.
        distance_from_prior: Geodesic distance from the prior.
        min_eigenvalue_ratio: Smallest eigenvalue of ``P0^-1/2 P P0^-1/2``.
        moments: Axes along which the first moment is identified.
        std_doubted: Standard deviations ``(13,)`` of quantities and first moments, for enlarged prior errors.
        std_prior: Standard deviations ``(13,)`` in the prior, or in the default prior where these are smaller.
        outlier: True if it left its prior by far more than links usually do: it has a payload, or absorbs an unmodelled
            effect. Then none of its quantities counts as identified.
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
        """Names of the :data:`QUANTITIES` that are identified; none for an outlier."""
        return () if self.outlier else tuple(name for name in QUANTITIES if name not in self.cannot_tell)


def is_significant(value: float, deviation: float) -> bool:
    """True if a quantity exceeds :data:`SIGNIFICANT_STDS` of its standard deviations."""
    return bool(abs(value) > SIGNIFICANT_STDS * deviation)


@dataclass(frozen=True, kw_only=True)
class EffectEstimate:
    """One coefficient of an effect at a joint, or at another place.

    Attributes:
        name: Name of the effect.
        joint: Name of the place.
        parameters: The parameter of this coefficient, then the effect's constants.
        from_data: Fraction of the prior variance that the data removed, 0 to 1.
    """

    name: str
    joint: str
    parameters: Mapping[str, Quantity]
    from_data: float

    @property
    def parameter(self) -> str:
        """Name of the coefficient's parameter."""
        return next(iter(self.parameters))

    @property
    def value(self) -> float:
        """Value of the parameter."""
        return self.parameters[self.parameter].value

    @property
    def std(self) -> float:
        """Standard deviation of the parameter."""
        return self.parameters[self.parameter].std

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        return self.parameters[self.parameter].unit


@dataclass(frozen=True, kw_only=True)
class WeighedEstimate:
    """Weighed mass [kg]: the ``given`` one and the estimated ``mass``, each with its standard deviation."""

    name: str
    given: float
    given_std: float
    mass: float
    std: float


@dataclass(frozen=True, eq=False)
class LinksInformation:
    """Log-likelihood of the inertias of all links together, maximised over the effects.

    ``|residuals + rows (x - parameters)|^2`` is minus twice the log-likelihood of link parameters x, up to a constant.

    Attributes:
        rows: ``(10 links, 10 links)``, upper triangular.
        residuals: ``(10 links,)``.
    """

    rows: FloatArray
    residuals: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """Result of a solve.

    Attributes:
        converged, reason: True if the solver converged, and why it stopped.
        seconds, steps: Duration [s] and number of steps.
        gamma: Weight of the prior as a fraction of the rows'.
        rows_accepted: Number of rows that were measured and used.
        rows_set_aside: Number of compressed rows without a projection from the prior; only (19) sets rows aside.
        links, effects, known: Estimates of the links, effects and weighed masses.
        parameters: ``(D,)`` of the measurement model.
        channels: Names of the measured channels.
        sigmas, rms_nominal, rms: ``(channels,)`` in the channels' units: standard deviations, and RMS residuals of the
            nominal and of the identified model; NaN where nothing was measured.
        prior_stds: Prior std ``(links,)`` of the links as found from the data, geodesic distances.
        information: Log-likelihood of all links together.
        rows, targets: Rows ``(<= D, D)`` and targets of all parameters of the posterior, with independent errors of
            standard deviation 1.
        posterior: Joint posterior of links and effects.
        within: Parameters ``(D,)`` fitted with only the effects that a file can hold, by the file's reader.
        warnings: Sentences on what makes the result doubtful.
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
    prior_stds: FloatArray
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
    """Standard deviations of the efforts that an estimate predicts, from the joint covariance of its parameters.

    They do not include the noise of sensors and the unmodelled remainder, ``estimate.sigmas``.

    Args:
        model: Model of the estimate.
        samples: N samples.
        estimate: The parameters and their posterior.

    Returns:
        Standard deviations ``(N, joints)``, NaN for joints whose effort is not measured.
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
