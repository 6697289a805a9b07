"""Body with ten uncertain quantities, and which of them are identified; one rule for links and payloads.

A quantity is identified if the data determine it without the prior: with the prior's errors three times as large as
assumed, its 95 % interval is still within 20 %, and narrower than that of the prior, or of the default prior where that
is narrower. (The prior of an outlier link is wide: an interval narrower than that means nothing.) A quantity that may
be zero is compared with a size of the body: a centre of mass with the radius of gyration about the link's origin, a
first moment with the mass times that, a product of inertia with the moments about its axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray, frozen

QUANTITIES = ("mass", "com x", "com y", "com z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Names of a link's ten quantities, in the order of :func:`geomid_ros.geometry.pseudo_inertia.quantities_of`."""
UNITS = ("kg", *("m", "m", "m"), *("kg m^2", "kg m^2", "kg m^2"), *("kg m^2", "kg m^2", "kg m^2"))
"""Units of the :data:`QUANTITIES`."""
STDS_OF_95 = 1.96
"""Half-width of a 95 % interval in standard deviations."""
_LARGEST_LOG = 50.0  # of an interval's factor: a wider one means that nothing is known


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

    @property
    def has_std(self) -> bool:
        """True if any standard deviation is known."""
        return bool(np.any(np.isfinite(self.std)))


def interval_of_positive(value: float, deviation: float) -> tuple[float, float]:
    """95 % interval of a positive quantity along the geodesic: of its logarithm, so that it stays positive."""
    factor = float(np.exp(min(STDS_OF_95 * deviation / value, _LARGEST_LOG))) if np.isfinite(deviation) else 1.0
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
