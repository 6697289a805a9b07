from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.places import Place
from geomid_ros.model.effects.situation import Situation
from geomid_ros.types import FloatArray


class EffortDelay(SituationEffect):
    """All efforts are measured too late by c [s]: measured(t) = true(t - c)."""

    name = "effort_delay"
    label = "a delay between efforts and motion"
    meaning = "measured effort(t) = true(t - delay), at all joints"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    settled_by = "faster motions"
    place = "robot"
    far = (2e-3,)
    absorbed = True
    corrected_in_samples = True

    def is_absurd(self, coefficients: FloatArray) -> bool:
        """Whether it is longer than a fifth of a second."""
        return bool(abs(coefficients[0]) > 0.2)

    def columns(self, situation: Situation, place: Place) -> FloatArray:  # noqa: ARG002  # all joints alike
        joints = situation.load.shape[1]
        columns = np.zeros((*situation.predicted.shape, 1))
        columns[:, :joints, 0] = -situation.rate[:, :joints]
        return columns

    @classmethod
    def effort_lag(cls, values: Values) -> float:
        """The delay."""
        return values["delay"]
