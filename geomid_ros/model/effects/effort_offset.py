from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import JointEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm, Values
from geomid_ros.model.effects.situation import JointMotion, Motion, Place
from geomid_ros.types import FloatArray


class EffortOffset(JointEffect):
    """A constant error of the effort measurement."""

    name = "effort_offset"
    label = "an offset of the measured effort"
    meaning = "measured effort = true + offset; with a gain, gain (true + offset)"
    parameters = (ParameterForm("offset", EFFORT),)
    like_a_payload = True
    of_sensor = True
    # Gravity is of the same form where a joint turns little: a wider prior lets an offset stand in for a mass.
    expected_share = 0.05
    settled_by = "a recording in which gravity loads the joint in both directions"

    def column(self, motion: JointMotion) -> FloatArray:
        return np.ones_like(motion.velocity)

    @classmethod
    def effort_shift(cls, values: Values) -> float:
        """The offset."""
        return values["offset"]

    def unsaid_efforts(self, values: Values, motion: Motion, place: Place) -> float:  # noqa: ARG002
        """It is an error of the sensor, no effort."""
        return 0.0
