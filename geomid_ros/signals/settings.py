"""Signal settings that users choose, and fixed numbers: physical limits, tolerances of arithmetic, bounds against
abuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np

from geomid_ros.errors import InputError, check_name
from geomid_ros.types import FloatArray

# Physical limits.
LARGEST_NUMBER = 1e9  # In SI units; no robot measures more
LARGEST_SPEED_LIMIT = tau  # [rad/s, m/s] Higher speed limits are taken for placeholders, which many URDFs have
BEST_POSITION_ACCURACY = 1e-6  # [rad, m] Best accuracy of a position
SHORTEST_CONTACT = 33e-3  # [s] A collision of 40 ms exceeds a quarter of its peak for so long
LONGEST_SAME = 0.05  # [s] The effort of a moving joint is rarely constant for longer
LONGEST_DELAY = 1.0  # [s] of efforts
ACCELEROMETER_BIAS = 0.03  # [m/s^2] Standard deviation of the bias between starts
SAMPLES_PER_CUTOFF_PERIOD = 8.0
CLEAR_RATIO = 4.0  # times as large as usual: a step or change that is clearly larger

# Tolerances of arithmetic.
PERIOD_ROUNDING = 10_000  # [ns] to which an inferred grid period is rounded; none is shorter
UNLIKE_ONE = 1e-2  # deviation of a quaternion's length from one
LARGEST_NOISE_GAIN = 2.0  # of cubic interpolation
MEAN_STEPS = 4  # iterations to the mean of poses; more change no digit but the last

# Bounds against abuse: the sender decides how much comes.
MESSAGES_UNTIL_DECISION = (
    1000  # messages of all topics, after which a suspicious one is decided without more of its topic
)
MOST_WAITING = 10_000  # messages kept until the period is known or while a publisher is silent; joint names
LONGEST_TOPIC_LAG = 60_000_000_000  # [ns] A topic that is this far behind is not waited for
MOST_KINDS = 50  # remembered message layouts, and reasons of a topic
LONGEST_REASON = 200  # [characters]
MOST_WAITING_BYTES = 100_000_000  # of waiting or remembered messages or rows
BYTES_BESIDE_NUMBERS = 400  # overhead of a remembered block


@dataclass(frozen=True)
class SignalSettings:
    """Settings of the filter and of efforts.

    ``cutoff`` [Hz] of the low-pass; ``period`` [s] of the time grid, inferred from the first joint messages when 0;
    ``max_gap`` [s]: a longer pause of a topic starts a new segment; ``effort_gain`` multiplies the messages' efforts to
    make N m (or N), one number for all joints or one by joint name (negative reverses the sign); ``effort_delay`` [s]:
    how long before its message's stamp an effort acted. ``merge``: each joint message has only some of the joints.
    """

    cutoff: float = 5.0
    period: float = 0.0
    max_gap: float = 0.5
    effort_gain: float | dict[str, float] = 1.0
    effort_delay: float = 0.0
    merge: bool = False

    def __post_init__(self) -> None:
        for name in ("cutoff", "max_gap"):
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
        """``max_gap`` in ns, the unit of stamps."""
        return round(self.max_gap * 1e9)

    def effort_gains(self, joints: Sequence[str]) -> FloatArray:
        """Return the factor of each joint's efforts ``(joints,)``. Raises InputError for a gain of an unknown joint."""
        if not isinstance(self.effort_gain, dict):
            return np.full(len(joints), float(self.effort_gain))
        for name in self.effort_gain:
            check_name("joint with an effort gain", name, joints)
        return np.array([self.effort_gain.get(name, 1.0) for name in joints])
