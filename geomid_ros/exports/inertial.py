"""An inertia to export, and sums of bodies in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.uncertain_inertia import UncertainInertia
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray


class Summand(NamedTuple):
    """A body in a sum: the homogeneous ``placement (4, 4)`` of its frame in that of the sum; ``sign`` is -1 for a body
    that is subtracted."""

    inertial: UncertainInertia
    placement: FloatArray
    sign: float = 1.0


@dataclass(frozen=True, eq=False)
class Export:
    """An ``inertial`` in the axes and about the origin of the link ``frame``, with a ``title`` and ``notes`` for its
    user."""

    title: str
    frame: str
    inertial: UncertainInertia
    notes: tuple[str, ...] = ()


def total(terms: Sequence[Summand], what: str) -> UncertainInertia:
    """The sum of bodies as one. Raises InputError that begins with ``what`` if no body can be so.

    Standard deviations are propagated one by one, by differences of plus and minus one standard deviation: files do not
    have the correlations of a body's quantities, so they count as independent. Unknown ones add nothing, unless none is
    known.
    """
    given = np.array([term.inertial.quantities for term in terms]).reshape(-1, 10)
    parameters = _sum(terms, given)
    if not pseudo_inertia.is_body(parameters):
        raise InputError(f"{what}: {_not_physical(parameters)}")
    deviations = np.array([term.inertial.std for term in terms])
    variance = np.full(10, 0.0 if np.any(np.isfinite(deviations)) else np.nan)
    for index in np.argwhere(np.isfinite(deviations)):
        step = np.zeros(given.shape)
        step[*index] = deviations[*index]
        above, below = (pseudo_inertia.quantities_of(_sum(terms, given + sign * step)) for sign in (1.0, -1.0))
        variance += (0.5 * (above - below)) ** 2
    return UncertainInertia(parameters=parameters, std=np.sqrt(variance))


def _sum(terms: Sequence[Summand], quantities: FloatArray) -> FloatArray:
    """Parameters ``(10,)`` of the sum, the bodies having ``quantities (bodies, 10)``."""
    pseudo = np.zeros((4, 4))
    for term, own in zip(terms, pseudo_inertia.from_parameters(pseudo_inertia.parameters_of(quantities)), strict=True):
        pseudo += term.sign * term.placement @ own @ term.placement.T
    return pseudo_inertia.to_parameters(pseudo)


def _not_physical(parameters: FloatArray) -> str:
    if parameters[0] <= 0.0:
        return f"it weighs {parameters[0]:.4g} kg; a body has a positive mass"
    moments = np.linalg.eigvalsh(pseudo_inertia.central_inertia(parameters))
    numbers = ", ".join(f"{moment:.3g}" for moment in moments)
    return (
        f"it weighs {parameters[0]:.4g} kg, but no body has its principal moments of inertia, {numbers} kg m^2: each "
        "must be less than the sum of the two others"
    )
