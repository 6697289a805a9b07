"""Motions whose formula is known: polynomials of time that begin and end at rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.polynomial import Chebyshev, Polynomial

from geomid_ros.types import FloatArray

BUMP = Polynomial([0.0, 0.0, 0.0, 64.0]) * Polynomial([1.0, -1.0]) ** 3
"""From 0 to 1 and back, with zero velocity and acceleration at both ends of the unit of time."""


@dataclass(frozen=True)
class Motion:
    """A position for each joint, as a function of the share of the ``duration`` [s] that has passed."""

    joints: tuple[str, ...]
    positions: tuple[Polynomial, ...]
    duration: float

    def rows(self, times: FloatArray, derivative: int = 0) -> FloatArray:
        """Positions or their derivatives ``(N, joints)``."""
        shares = times / self.duration
        columns = [(p.deriv(derivative) if derivative else p)(shares) for p in self.positions]
        return np.array(columns).T / self.duration**derivative

    def document(self, points: int) -> dict[str, Any]:
        """As ``trajectory.yaml`` has it."""
        times = np.linspace(0.0, self.duration, points)
        rows = [self.rows(times, derivative).tolist() for derivative in range(3)]
        return {
            "joint_names": list(self.joints),
            "points": [
                {
                    "positions": position,
                    "velocities": velocity,
                    "accelerations": acceleration,
                    "time_from_start": {"sec": int(time), "nanosec": round(1e9 * (time - int(time)))},
                }
                for time, position, velocity, acceleration in zip(times.tolist(), *rows, strict=True)
            ],
        }

    def write(self, path: Path, points: int) -> Path:
        path.write_text(yaml.safe_dump(self.document(points)), encoding="utf-8")
        return path


def bump(joints: tuple[str, ...], duration: float, amplitude: float = 0.5, start: float = 0.2) -> Motion:
    """All joints to and fro, each by another ``amplitude``, the first by the largest."""
    sizes = amplitude / np.arange(1, len(joints) + 1)
    return Motion(joints, tuple(start + size * BUMP for size in sizes), duration)


def lively(joints: tuple[str, ...], duration: float, amplitude: float, seed: int = 0) -> Motion:
    """All joints at once, fast and slow."""
    random = np.random.default_rng(seed)
    waves = [Chebyshev(random.normal(0.0, amplitude, 9), domain=[0.0, 1.0]) for _ in joints]
    return Motion(joints, tuple(BUMP * wave.convert(kind=Polynomial) for wave in waves), duration)
