"""Which numbers of a body are identified: of links and of payloads by one rule.

A number is identified if the data say it, whatever the prior is worth: were the prior's errors three times as large as
they are taken to be, its 95 % interval would still be within 20 % of it, and narrower than the one that the prior has,
or the usual prior where that is narrower. (The prior of a link that left it is wide: less than that says nothing.) What
may be zero is compared with a size of the body: a centre of mass with the radius of gyration about the link's origin, a
first moment with the mass times that, a product of inertia with the moments about its axes.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.uncertain_inertia import SURE
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray

WITHIN = float(np.log(1.2))
"""How far a number's interval may reach along the geodesic: to 20 % of it."""


def identified(parameters: FloatArray, doubted: FloatArray, of_prior: FloatArray) -> BoolArray:
    """Whether the numbers of a body are identified ``(13,)``: its quantities, then its first moments.

    Args:
        parameters: of the body ``(10,)``.
        doubted: standard deviations of the numbers ``(13,)`` with a prior that is :func:`doubted`.
        of_prior: the same in the prior, or in the usual one where that is narrower ``(13,)``.
    """
    return np.asarray((SURE * doubted <= WITHIN * sizes(parameters)) & (doubted <= of_prior))


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
