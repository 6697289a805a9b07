"""What a quadruped does on its feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geomid_ros.types import FloatArray

_FADE = 0.7  # [s] at the beginning and at the end of a motion
_PERIOD, _SWING = 0.6, 0.4  # of the trot [s], and the share of it in which a foot is lifted

Gait = Callable[[FloatArray, FloatArray, np.random.Generator], tuple[FloatArray, FloatArray]]
"""From times ``(N,)`` and feet where they stand ``(feet, 3)``: the trunk's way ``(N, 6)``, translation and rotation
vector, and the feet's ``(N, feet, 3)``, both added to where they are at rest."""


def _faded(time: FloatArray, wait: float = 0.0) -> FloatArray:
    """From 0 to 1 and back ``(N, 1)``, smoothly, after a ``wait`` [s] at both ends."""
    share = np.clip((np.minimum(time, time[-1] - time) - wait) / _FADE, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))[:, None]


def _sway(time: FloatArray, size: FloatArray, numbers: np.random.Generator) -> FloatArray:
    """Sums of sines ``(N, len(size))``."""
    frequency = numbers.uniform(0.3, 1.5, (4, len(size)))
    phase = numbers.uniform(0.0, 2.0 * np.pi, frequency.shape)
    waves = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return np.asarray(_faded(time) * size * np.sum(waves, axis=1) / 3.0)


def _wobble(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    trunk = _sway(time, np.array([0.025, 0.02, 0.02, 0.08, 0.08, 0.08]), numbers)
    return trunk, np.zeros((len(time), *home.shape))


def _lift(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Each foot in turn leaves the ground and moves, the trunk over the other feet."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.01, 0.03, 0.03, 0.04]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, part in enumerate(np.array_split(np.arange(len(time)), len(home))):
        own = time[part] - time[part[0]]
        trunk[part, :2] -= 0.3 * home[foot, :2] * _faded(own)
        high = np.array([0.0, 0.0, 0.09])
        feet[part, foot] = _faded(own, _FADE) * (high + _sway(own, np.array([0.05, 0.04, 0.02]), numbers))
    return trunk, feet


def _trot(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Diagonal feet step together, on the spot."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.005, 0.02, 0.02, 0.02]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, (x, y, _) in enumerate(home):
        phase = (time / _PERIOD + (0.5 if x * y > 0.0 else 0.0)) % 1.0
        swing = np.clip(phase / _SWING, 0.0, 1.0)
        feet[:, foot, 2] = 0.05 * np.sin(np.pi * swing) ** 2 * _faded(time)[:, 0]
    return trunk, feet


GAITS: dict[str, Gait] = {"wobble": _wobble, "lift": _lift, "trot": _trot}
"""What a robot can do: sway with all feet down, lift its feet one by one, trot on the spot."""
