from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.effects.effect import SensorEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.situation import Motion
from geomid_ros.types import FloatArray


class WrenchOffset(SensorEffect):
    """A constant error of a wrench sensor: one more number for each of its axes."""

    name = "wrench_offset"
    label = "an offset of the wrench sensor"
    meaning = "measured wrench = true + (fx ... tz), in the sensor's frame"
    parameters = (
        *(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy", "fz")),
        *(ParameterForm(name, ("N m", "N m"), optional=True) for name in ("tx", "ty", "tz")),
    )
    settled_by = "static poses with the sensor in many orientations"
    like_a_payload = True
    corrected_in_samples = True

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        return np.broadcast_to(np.eye(len(axes)), (*motion.position.shape[:-1], len(axes), len(axes)))

    @classmethod
    def wrench_shift(cls, values: Values) -> dict[str, float]:
        """The offset."""
        return dict(values)
