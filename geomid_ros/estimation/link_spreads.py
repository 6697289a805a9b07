"""How wrong links' priors are: each by a spread of its own, whose square has an inverse-gamma distribution about the
usual one. Its tails are heavy: a link that the data call wrong is let go, and loosens no other."""

from __future__ import annotations

import numpy as np

from geomid_ros.geometry.pseudo_inertia import SIZE
from geomid_ros.types import FloatArray

CERTAINTY = 20.0
"""The usual spread counts as much as the directions of two links."""


def likely_spreads(
    off: FloatArray, variances: FloatArray, usual: FloatArray, certainty: float = CERTAINTY
) -> FloatArray:
    """MacKay's re-estimate ("Bayesian interpolation", 1992) ``(links,)``: the mean square of each link's error, what
    the data leave undetermined included.

    Args:
        off: tangent coordinates ``(10 links,)`` of the links from their priors.
        variances: of these ``(10 links,)``, by the data and the priors.
        usual: spreads ``(links,)``, geodesic distances.
        certainty: how many directions the usual spread counts as much as.
    """
    squares = np.sum((off**2 + variances).reshape(-1, SIZE), axis=1)
    return np.asarray(np.sqrt((squares + certainty * usual**2) / (SIZE + certainty)))


def cost_of_spreads(spreads: FloatArray, usual: FloatArray, certainty: float = CERTAINTY) -> float:
    """Minus twice the logarithm of the distribution of ``spreads (links,)``, up to a constant."""
    relative = spreads / usual
    return certainty * float(np.sum(relative**-2.0 + 2.0 * np.log(relative)))
