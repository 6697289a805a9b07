"""On which side of their play the gears are."""

from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.backlash import CROSSINGS
from geomid_ros.types import FloatArray


def sides(load: FloatArray, period: float) -> FloatArray:
    """From -1 to 1 ``(N, J, K)`` for each of :data:`CROSSINGS`, under the ``load (N, J)`` of the gears, sampled every
    ``period`` [s].

    The load pushes the link through the play against a drag: its speed is in proportion to the load.
    """
    usual = np.maximum(np.std(load, axis=0), 1e-12)
    steps: FloatArray = (load / usual)[:, :, None] * (2.0 * period / np.array(CROSSINGS))
    result = np.empty_like(steps)
    side = np.sign(steps[0])
    for index, step in enumerate(steps):
        side = np.minimum(np.maximum(side + step, -1.0), 1.0)
        result[index] = side
    return result
