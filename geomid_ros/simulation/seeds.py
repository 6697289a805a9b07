"""Independent streams of random numbers, so that changing one choice leaves the others as they were."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class RandomStream(IntEnum):
    """What a stream of random numbers decides."""

    INERTIA = 0
    EFFECTS = 1
    ORDER = 2
    MOTION = 3
    NOISE = 4
    HIDDEN = 5
    REALISTIC = 6


def generator(seed: int, stream: RandomStream, *part: int) -> np.random.Generator:
    """The numbers of one stream of a seed, or of a ``part`` of it, from their beginning."""
    return np.random.default_rng([seed, stream, *part])
