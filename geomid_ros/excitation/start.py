"""Where a motion begins and ends, unless it is said."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geomid_ros.excitation.limits import MotionLimits
from geomid_ros.types import FloatArray

_WIDEST = np.pi  # [rad, m]
_TRIED = 100


def starts(limits: MotionLimits) -> Iterator[FloatArray]:
    """Postures ``(J,)`` to begin from, the most obvious first: zero where that is in the middle half of a range, the
    middle of the ranges, and others at random in their middle halves."""
    low, high = limits.position.T
    wide = np.clip(low, -_WIDEST, None), np.clip(high, None, _WIDEST)
    middle, half = 0.5 * (wide[0] + wide[1]), 0.5 * (wide[1] - wide[0])
    inner = middle - 0.5 * half, middle + 0.5 * half
    yield np.where((inner[0] < 0.0) & (inner[1] > 0.0), 0.0, middle)
    yield middle
    random = np.random.default_rng(0)
    for _ in range(_TRIED):
        yield middle + 0.5 * half * random.uniform(-1.0, 1.0, len(low))
