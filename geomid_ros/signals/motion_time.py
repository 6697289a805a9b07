"""How much time has passed between two pieces of a motion, by the motion itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.signals.limits import FINEST
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class End:
    """Where a piece of a motion ends, or begins: ``place`` and ``speed`` ``(joints,)``, and their variances."""

    place: FloatArray
    speed: FloatArray
    place_variance: FloatArray
    speed_variance: FloatArray


def end_of(times: FloatArray, positions: FloatArray) -> End:
    """By parabolas through positions ``(N, joints)``, at time zero."""
    terms = np.vander(times, 3, increasing=True)
    fitted, *_ = np.linalg.lstsq(terms, positions, rcond=None)
    spread = np.linalg.inv(terms.T @ terms)
    noise = np.sum((positions - terms @ fitted) ** 2, axis=0) / (len(times) - 3) + FINEST**2
    return End(fitted[0], fitted[1], spread[0, 0] * noise, spread[1, 1] * noise)


def unlikely(left: End, right: End, time: float) -> float:
    """How unlikely it is that a time [s] has passed from the end of a motion to its next beginning: the sum of squares
    of the joints' ways by the mean of the speeds, in standard deviations."""
    error = right.place - left.place - 0.5 * time * (left.speed + right.speed)
    variance = left.place_variance + right.place_variance
    variance += 0.25 * time**2 * (left.speed_variance + right.speed_variance)
    return float(np.sum(error**2 / variance))
