from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.effects.effect import SensorEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Motion
from geomid_ros.types import FloatArray


class ImuOffset(SensorEffect):
    """A constant error of an IMU's acceleration across gravity, times the robot's mass: a bias, or the IMU is turned.

    Along gravity it cannot be distinguished from mass.
    """

    name = "imu_offset"
    label = "an offset of the IMU's acceleration"
    meaning = "force of the ground = mass * measured acceleration + (fx, fy), in the base frame"
    parameters = tuple(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy"))
    settled_by = "standing on level ground, and again turned by half a turn"
    place = "base"
    count = 2

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        return np.broadcast_to(np.eye(len(axes)), (*motion.position.shape[:-1], len(axes), len(axes)))
