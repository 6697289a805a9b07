from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import Effect, SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm, Quantities, Values
from geomid_ros.model.effects.situation import Place, Situation, joint_of
from geomid_ros.types import FloatArray

_USED = (-0.7, 2.0)  # errors of scale at which a model may be built


class EffortGain(SituationEffect):
    """An effort sensor's error of scale: measured ``(1 + c)`` times the true effort."""

    name = "effort_gain"
    label = "a wrong gain of the measured effort"
    meaning = "measured effort = gain (true + offset)"
    parameters = (ParameterForm("gain", ("-", "-"), above=0.0),)
    settled_by = "the same motion with a known payload"
    adds_up = False
    like_a_payload = True
    absorbed = True
    usual = (0.1,)
    scales_measurement = True
    corrected_in_samples = True

    def is_absurd(self, coefficients: FloatArray) -> bool:
        """Whether a model may not be built there."""
        return bool(np.any(coefficients != self.linearised_at(coefficients)))

    def linearised_at(self, coefficients: FloatArray) -> FloatArray:
        return np.clip(coefficients, *_USED)

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        return situation.column_of(joint, situation.predicted[:, joint])

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The gain."""
        return 1.0 + coefficients, np.eye(1)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """The gain's distance from 1."""
        return {cls(): (values["gain"] - 1.0,)}

    @classmethod
    def together(cls, first: Quantities, second: Quantities) -> Quantities:
        """Gains are multiplied."""
        return {"gain": second["gain"].scaled(first["gain"].value)}

    @classmethod
    def effort_scale(cls, values: Values) -> float:
        """The gain."""
        return values["gain"]
