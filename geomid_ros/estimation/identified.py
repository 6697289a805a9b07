"""Which numbers of a body are identified: of links and of payloads by one rule.

A number is identified if its 95 % interval is within 20 % of it, and if it is the data that say so: they leave at most
half of the standard deviation that the number has in the prior, or in the usual prior where that is narrower. (The
prior of a link that left it is wide: half of that says nothing.) What may be zero is compared with a size of the body:
a centre of mass with the radius of gyration about the link's origin, a first moment with the mass times that, a product
of inertia with the moments about its axes.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.uncertain_inertia import SURE
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray

WITHIN = float(np.log(1.2))
"""How far a number's interval may reach along the geodesic: to 20 % of it."""
_OF_PRIOR = 0.5


def identified(parameters: FloatArray, deviations: FloatArray, of_prior: FloatArray) -> BoolArray:
    """Whether the numbers of a body are identified ``(13,)``: its quantities, then its first moments.

    Args:
        parameters: of the body ``(10,)``.
        deviations: standard deviations of the numbers ``(13,)``.
        of_prior: the same in the prior, or in the usual one where that is narrower ``(13,)``.
    """
    return np.asarray((SURE * deviations <= WITHIN * sizes(parameters)) & (deviations <= _OF_PRIOR * of_prior))


def sizes(parameters: FloatArray) -> FloatArray:
    """What the numbers of a body ``(10,)`` are compared with ``(13,)``."""
    mass, central = parameters[0], pseudo_inertia.central_inertia(parameters)
    centre = pseudo_inertia.centre_of_mass(parameters)
    extent = np.sqrt(0.5 * np.trace(central) / mass + centre @ centre)
    moments = np.sqrt(np.diag(central))
    products = pseudo_inertia.inertia_entries(np.outer(moments, moments))
    return np.concatenate([[mass], np.full(3, extent), products, np.full(3, mass * extent)])


def numbers(parameters: FloatArray) -> FloatArray:
    """The numbers of bodies ``(..., 10)``: quantities and first moments ``(..., 13)``."""
    return np.concatenate([pseudo_inertia.quantities_of(parameters), parameters[..., 1:4]], axis=-1)
