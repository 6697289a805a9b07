"""How signals are filtered and what an effort number means, as users set it; and numbers that are no rules: what a
robot can do, how far arithmetic is trusted, and bounds against abuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.types import FloatArray

# Physical limits.
LARGEST_NUMBER = 1e9  # In SI units: no robot measures more
FASTEST = tau  # [rad/s, m/s] No limit of a speed above is believed, as many URDFs have placeholders
FINEST = 1e-6  # [rad, m] No position is measured better
SHORTEST_CONTACT = 33e-3  # [s] A collision of 40 ms is larger than a quarter of its height for so long
LONGEST_SAME = 0.05  # [s] An effort that moves a joint is hardly the same for longer
LONGEST_DELAY = 1.0  # [s] Of efforts
ACCELEROMETER_BIAS = 0.03  # [m/s^2] Standard deviation of what it shows otherwise from one start to the next
CLEAR = 4.0  # What is clearly larger is so many times as large: a step, or a change, beside usual ones

# Tolerances of arithmetic.
PERIOD_ROUNDING = 10_000  # [ns] An inferred period of the grid is rounded to this; none is shorter
UNLIKE_ONE = 1e-2  # of a quaternion's length
LARGEST_NOISE_GAIN = 2.0  # of the interpolation by cubics
MEAN_STEPS = 4  # iterations to the mean of poses, at most
MEAN_TOLERANCE = 1e-12  # at which they end

# Bounds against abuse: the sender decides how much comes.
PATIENCE = 1000  # messages of all topics: after so many a suspicious one passes, though fewer of its own have come
MOST_WAITING = 10_000  # messages that are kept until the period is known, or while a publisher is silent; joints' names
HORIZON = 60_000_000_000  # [ns] A topic this far behind the others is not waited for
MOST_KINDS = 50  # layouts of messages that are remembered, and reasons of a topic
LONGEST_REASON = 200  # [characters]
MOST_WAITING_BYTES = 100_000_000  # of messages or rows that wait or are remembered
BYTES_BESIDE_NUMBERS = 400  # of a remembered block


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
