"""Result of a solve: links and effects with their uncertainty, which are identified, and how the solver ended.

A quantity is identified if the data determine it without the prior: with the prior's errors three times as large as
assumed, its 95 % interval is still within 20 %, and narrower than that of the prior, or of the default prior where that
is narrower. (The prior of an outlier link is wide: an interval narrower than that means nothing.) A quantity that may
be zero is compared with a size of the body: a centre of mass with the radius of gyration about the link's origin, a
first moment with the mass times that, a product of inertia with the moments about its axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from geomid_ros.estimation.posterior import Posterior
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import Quantity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray, frozen

QUANTITIES = ("mass", "com x", "com y", "com z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Names of a link's ten quantities, in the order of :func:`geomid_ros.geometry.pseudo_inertia.quantities_of`."""
UNITS = ("kg", *("m", "m", "m"), *("kg m^2", "kg m^2", "kg m^2"), *("kg m^2", "kg m^2", "kg m^2"))
"""Units of the :data:`QUANTITIES`."""
STDS_OF_95 = 1.96
"""Half-width of a 95 % interval in standard deviations."""


@dataclass(frozen=True, eq=False, kw_only=True)
class UncertainInertia:
    """Body in the frame of a link.

    Attributes:
        parameters: ``(10,)`` in pinocchio's order, about the frame's origin.
        std: Standard deviations ``(10,)`` of the :data:`QUANTITIES`; zero if exact, NaN if unknown.
        merged: Links that are fixed to it and included in it.
        cannot_tell: Names of the :data:`QUANTITIES` that are not identified, see :func:`identified`; None if unknown.
        from_data: Fraction of the prior variance that the data removed, 0 to 1; NaN if unknown.
    """

    parameters: FloatArray
    std: FloatArray
    merged: tuple[str, ...] = ()
    cannot_tell: tuple[str, ...] | None = None
    from_data: float = np.nan

    @cached_property
    def quantities(self) -> FloatArray:
        """Values of the :data:`QUANTITIES` ``(10,)``."""
        return frozen(pseudo_inertia.quantities_of(self.parameters))

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.quantities[0])

    @property
    def com(self) -> FloatArray:
        """Centre of mass ``(3,)`` in the link's frame [m]."""
        return self.quantities[1:4]

    @property
    def inertia(self) -> FloatArray:
        """Inertia ``(3, 3)`` about the centre of mass in the link's axes [kg m^2]."""
        return pseudo_inertia.rotational_inertia(self.quantities)

    @property
    def std_mass(self) -> float:
        """Standard deviation of the mass [kg]."""
        return float(self.std[0])

    @property
    def std_com(self) -> FloatArray:
        """Standard deviations ``(3,)`` of the centre of mass [m]."""
        return self.std[1:4]

    @property
    def std_inertia(self) -> FloatArray:
        """Standard deviations ``(3, 3)`` of the inertia [kg m^2]."""
        return pseudo_inertia.rotational_inertia(self.std)

    @property
    def mass_interval(self) -> tuple[float, float]:
        """95 % interval of the mass [kg]."""
        return interval_of_positive(self.mass, self.std_mass)

    def may_weigh(self, mass: float) -> bool:
        """True if a ``mass`` [kg] is within 95 % of the standard deviation of this one."""
        return abs(self.mass - mass) < STDS_OF_95 * self.std_mass

    @property
    def has_std(self) -> bool:
        """True if any standard deviation is known."""
        return bool(np.any(np.isfinite(self.std)))


def interval_of_positive(value: float, deviation: float) -> tuple[float, float]:
    """95 % interval of a positive quantity along the geodesic: of its logarithm, so that it stays positive."""
    factor = float(np.exp(min(STDS_OF_95 * deviation / value, np.log(FINEST)))) if np.isfinite(deviation) else 1.0
    return value / factor, value * factor


WITHIN = float(np.log(1.2))
"""Largest half-width of an identified quantity's 95 % interval along the geodesic: 20 %."""


def identified(parameters: FloatArray, with_enlarged_prior: FloatArray, of_prior: FloatArray) -> BoolArray:
    """True for each number of a body that is identified ``(13,)``: its quantities, then its first moments.

    Args:
        parameters: parameters of the body ``(10,)``.
        with_enlarged_prior: standard deviations ``(13,)`` of the numbers, for enlarged prior errors.
        of_prior: standard deviations ``(13,)`` in the prior, or in the default prior where these are smaller.
    """
    return np.asarray(
        (STDS_OF_95 * with_enlarged_prior <= WITHIN * sizes(parameters)) & (with_enlarged_prior <= of_prior)
    )


def sizes(parameters: FloatArray) -> FloatArray:
    """Reference sizes ``(13,)`` that the numbers of a body ``(10,)`` are compared with."""
    mass, central = parameters[0], pseudo_inertia.central_inertia(parameters)
    centre = pseudo_inertia.centre_of_mass(parameters)
    extent = np.sqrt(0.5 * np.trace(central) / mass + centre @ centre)
    moments = np.sqrt(np.diag(central))
    products = pseudo_inertia.inertia_entries(np.outer(moments, moments))
    return np.concatenate([[mass], np.full(3, extent), products, np.full(3, mass * extent)])


def quantities_and_moments(parameters: FloatArray) -> FloatArray:
    """Quantities and first moments ``(..., 13)`` of bodies ``(..., 10)``."""
    return np.concatenate([pseudo_inertia.quantities_of(parameters), parameters[..., 1:4]], axis=-1)


SIGNIFICANT_STDS = 3.0
"""Ratio of a quantity or effect to its standard deviation from which it is significant."""
LACKING = 0.1
"""Remainder of a model under the change of a body, as a fraction of the efforts that this adds."""
FINEST = 1e7
"""Inverse of the smallest relative error of an inertia that data can resolve."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkEstimate(UncertainInertia):
    """Identified inertia of a moving link.

    Attributes:
        name: Name of the link.
        distance_from_prior: Geodesic distance from the prior.
        min_eigenvalue_ratio: Smallest eigenvalue of ``P0^-1/2 P P0^-1/2``.
        moments: Axes along which the first moment is identified; none for an outlier.
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


class Predictor(NamedTuple):
    """Arguments with which a measurement model predicts: ``parameters (D,)`` with the effects beside the gains of the
    joints' drives, and these ``drive_gains (channels,)``. Or those of several models, ``(D, K)`` and ``(channels, K)``.
    """

    parameters: FloatArray
    drive_gains: FloatArray

    def beside(self, parameters: FloatArray) -> Predictor:
        """Return this one and a model of ``parameters (D,)`` without gains, in this order."""
        gains = np.column_stack([self.drive_gains, np.ones(len(self.drive_gains))])
        return Predictor(np.column_stack([self.parameters, parameters]), gains)


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
        parameters: ``(D,)`` of the measurement model, fitted without gains of the drives.
        predictor: Parameters with the same links, and gains of the drives, to predict with.
        channels: Names of the measured channels.
        sigmas, rms_nominal, rms: ``(channels,)`` in the channels' units: standard deviations, and RMS residuals of the
            URDF and of the identified model; NaN where nothing was measured.
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
    predictor: Predictor
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
