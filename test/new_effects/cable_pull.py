from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.effects.effect import SensorEffect
from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Motion
from geomid_ros.types import FloatArray

_FORCES, _TORQUES = ("fx", "fy", "fz"), ("tx", "ty", "tz")


class CablePull(SensorEffect):
    """A cable that the first joint winds up pulls at a wrench sensor: ``c q_1`` at each of its axes."""

    name = "cable_pull"
    label = "a cable that pulls at the wrench sensor"
    meaning = "measured wrench = true + (fx ... tz) q1, in the sensor's frame"
    parameters = (
        *(ParameterForm(name, ("N/rad", "N/m"), optional=True) for name in _FORCES),
        *(ParameterForm(name, ("N m/rad", "N"), optional=True) for name in _TORQUES),
    )
    settled_by = "the first joint alone, slowly through its range"

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        result: FloatArray = motion.position[..., 0, None, None] * np.eye(len(axes))
        return result
