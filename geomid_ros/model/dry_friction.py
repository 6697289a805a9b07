"""What is known of dry friction before anything is measured: beside standstill, too, it does not drive a joint.

Rows near a reversal say little, and depend on the past: what is extrapolated from them to standstill can have the wrong
sign. A simulator to which that is given shakes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.effects import Effect, Place
from geomid_ros.types import FloatArray

_EXACT = 1e-5  # standard deviation, of the friction: far less than that of any rows


def held_from_driving(terms: Sequence[tuple[Effect, Place] | None], values: FloatArray) -> FloatArray:
    """Rows that hold the sum of a place's dry friction at zero, where coefficients make it negative.

    Args:
        terms: the effect of each coefficient, and where it is; None for what is no effect.
        values: the coefficients ``(k,)``; zero for those that are left out.

    Returns:
        Rows ``(r, k)`` of target 0 and standard deviation 1; r is 0 where no joint is driven.
    """
    places: dict[Place, list[int]] = {}
    for index, term in enumerate(terms):
        if term is not None and term[0].is_dry_friction and values[index]:
            places.setdefault(term[1], []).append(index)
    driven = [own for own in places.values() if len(own) > 1 and np.sum(values[own]) < 0.0]
    rows = np.zeros((len(driven), len(values)))
    for row, own in zip(rows, driven, strict=True):
        row[own] = 1.0 / (_EXACT * np.max(np.abs(values[own])))
    return rows
