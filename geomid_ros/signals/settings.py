"""How signals are filtered, and what an effort number means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.signals.limits import LONGEST_DELAY, PERIOD_ROUNDING
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class SignalSettings:
    """How signals are filtered, and what an effort number means.

    ``cutoff`` [Hz] of the low-pass; ``period`` [s] of the time grid, inferred from the first joint messages when 0;
    ``max_gap`` [s] a longer pause of a topic starts a new segment; ``effort_gain`` multiplies the messages' efforts to
    make N m (or N), one number for all joints or one by joint name (negative reverses the sign); ``effort_delay`` [s]
    says how long before its message's stamp an effort acted. ``merge``: each joint message has only some of the joints.
    """

    cutoff: float = 5.0
    period: float = 0.0
    max_gap: float = 0.5
    effort_gain: float | dict[str, float] = 1.0
    samples_per_cutoff_period: float = 8.0
    effort_delay: float = 0.0
    merge: bool = False

    def __post_init__(self) -> None:
        for name in ("cutoff", "max_gap", "samples_per_cutoff_period"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"signal setting {name} is {getattr(self, name)}, expected a number greater than zero")
        if self.period != 0.0 and not PERIOD_ROUNDING * 1e-9 <= self.period < np.inf:
            raise InputError(f"signal setting period is {self.period}, expected 0 or at least {PERIOD_ROUNDING} ns")
        if not abs(self.effort_delay) <= LONGEST_DELAY:
            raise InputError(
                f"signal setting effort_delay is {self.effort_delay}, expected at most {LONGEST_DELAY:g} s"
            )
        gains = self.effort_gain.values() if isinstance(self.effort_gain, dict) else (self.effort_gain,)
        if not all(np.isfinite(gain) and gain != 0.0 for gain in gains):
            raise InputError(f"effort gain {self.effort_gain}: expected finite numbers other than zero")

    @property
    def max_gap_ns(self) -> int:
        """``max_gap`` in ns, as stamps are."""
        return round(self.max_gap * 1e9)

    @property
    def effort_delay_ns(self) -> int:
        """``effort_delay`` in ns."""
        return round(self.effort_delay * 1e9)

    def effort_gains(self, joints: Sequence[str]) -> FloatArray:
        """The factor of each joint's efforts ``(joints,)``. Raises InputError for a gain of an unknown joint."""
        if not isinstance(self.effort_gain, dict):
            return np.full(len(joints), float(self.effort_gain))
        for name in self.effort_gain:
            if name not in joints:
                raise unknown_name("joint with an effort gain", name, joints)
        return np.array([self.effort_gain.get(name, 1.0) for name in joints])
