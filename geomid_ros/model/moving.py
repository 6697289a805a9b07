"""How well the motion of a joint tells its dry friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.columns import JointColumn
from geomid_ros.model.effects import JointMotion
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray, IntArray

STILL = 0.01
"""[rad/s or m/s] below this friction is no function of speed."""
# At a reversal friction depends on the past: within the filter's window a joint may stand still for so short a time,
# and must move so much one way.
_REST_SHARE = 0.3
_SAME_WAY = 0.97


class _Rest:
    """Whether a joint stands still."""

    def column(self, motion: JointMotion) -> FloatArray:
        return np.asarray(np.abs(motion.velocity) < STILL, dtype=np.float64)


@dataclass(frozen=True)
class _Direction:
    """The direction of motion, smoothed over a speed [rad/s or m/s]."""

    smoothing: float

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.smoothing)


SIGN = JointColumn(_Direction(0.003))
"""The direction of motion."""
SMOOTH_SIGN = JointColumn(_Direction(0.02))
"""The same, of friction that sets in slowly."""
REST = JointColumn(_Rest())
"""The share of the filter's window in which the joint stands still."""


def moves_one_way(samples: Samples) -> BoolArray:
    """Whether each joint moves one way at an instant ``(N, joints)``: neither at rest nor near a reversal."""
    moving: BoolArray = (np.abs(samples.column(SIGN)) > _SAME_WAY) & (samples.column(REST) < _REST_SHARE)
    return moving


REGIMES = 3
"""How many regimes of a joint's motion there are."""


def regimes(samples: Samples) -> IntArray:
    """The regime of each joint's motion at an instant ``(N, joints)``: 0 if it moves so fast that dry friction has its
    full level, 1 if it moves one way more slowly, 2 at rest and near a reversal."""
    fast = np.abs(samples.column(SMOOTH_SIGN)) > _SAME_WAY
    return np.where(moves_one_way(samples), np.where(fast, 0, 1), REGIMES - 1)
