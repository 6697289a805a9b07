"""What adaptation must not learn from, and the latch that switches it off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.samples import STILL
from geomid_ros.types import FloatArray

LASTING = 0.1
"""Time [s] for which something may be wrong before the correction is switched off; nothing is learned meanwhile."""
LATER = 2.0
"""Allowed delay as a multiple of the delay that the gain is set for; the loop is stable up to pi times."""
_SATURATED = 0.99  # of the effort limit
_MEMORY = 1.0  # [s] in which a long delay is forgotten, and what was wrong for LASTING


@dataclass(frozen=True, eq=False)
class Reading:
    """What a robot measured at a ``time`` [s]: ``position, velocity, effort (joints,)``."""

    time: float
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray

    @property
    def is_complete(self) -> bool:
        """True if nothing is missing."""
        return bool(np.isfinite([self.position, self.velocity, self.effort]).all())

    def repeats(self, other: Reading) -> bool:
        """True if all numbers are those of the other one."""
        return (
            np.array_equal(self.position, other.position)
            and np.array_equal(self.velocity, other.velocity)
            and np.array_equal(self.effort, other.effort)
        )


class Latch:
    """Adds up for how long something is wrong, and remembers why the correction is off."""

    def __init__(self) -> None:
        self._before = -np.inf
        self._is_wrong = False
        self._wrong = 0.0  # [s], less what is forgotten
        self.reason = ""
        """Why the correction is off, in a sentence; empty while it is on."""

    def take(self, now: float, faults: Sequence[str]) -> None:
        """Note what is wrong from ``now`` [s] on, in sentences: what comes and goes adds up."""
        passed, self._before = max(0.0, now - self._before), now
        self._wrong = self._wrong + passed if self._is_wrong else max(0.0, self._wrong - passed * LASTING / _MEMORY)
        self._is_wrong = bool(faults)
        if faults and self._wrong >= LASTING:
            self.close(faults[0])

    def close(self, reason: str) -> None:
        """Switch off, for the first ``reason``."""
        self.reason = self.reason or reason


class Delay:
    """Delay of the loop [s]: age of the data and the time between them, the longest of about a second."""

    def __init__(self) -> None:
        self.usual = 0.0
        """The delay that the gain is set for."""

    def take(self, delay: float, step: float) -> str:
        """Note a delay, ``step`` seconds after the one before. Returns what is wrong with it, or nothing."""
        if self.usual and delay > LATER * self.usual:
            return f"joint states are {1e3 * delay:.0f} ms late, after {1e3 * self.usual:.0f} ms before"
        self.usual = max(delay, self.usual * (1.0 - step / _MEMORY))
        return ""


def faults_of(
    joints: tuple[str, ...], limits: FloatArray, reading: Reading, before: Reading, commanded: FloatArray
) -> list[str]:
    """What is wrong with a reading after the one ``before``, in sentences.

    Args:
        joints: names.
        limits: effort limits ``(joints,)``.
        reading, before: what was measured.
        commanded: velocities ``(joints,)``.
    """
    faults = []
    used = np.abs(reading.effort) / limits
    if np.max(used) >= _SATURATED:
        faults.append(f"the effort of joint '{joints[int(np.argmax(used))]}' saturates")
    if reading.repeats(before) and np.max(np.abs(commanded)) > STILL:
        faults.append("joint states repeat while the robot is to move")
    return faults
