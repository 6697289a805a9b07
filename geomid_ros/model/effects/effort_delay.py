from __future__ import annotations

from geomid_ros.model.effects.effect import SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.situation import Place, Situation
from geomid_ros.types import FloatArray


class EffortDelay(SituationEffect):
    """All efforts are measured too late by c [s]: measured(t) = true(t - c).

    It is told from what the rigid bodies need. Dry friction follows a reversal later than any function of the speed
    says (pre-sliding), and by its large steps passes for a delay of some milliseconds.
    """

    name = "effort_delay"
    label = "a delay between efforts and motion"
    meaning = "measured effort(t) = true(t - delay), at all joints"
    parameters = (ParameterForm("delay", ("s", "s"), above=-1.0, below=1.0),)
    settled_by = "faster motions"
    place = "robot"
    far = (2e-3,)
    absorbed = True
    largest = 0.2  # [s]
    corrected_in_samples = True

    def columns(self, situation: Situation, place: Place) -> FloatArray:  # noqa: ARG002  # all joints alike
        joints = slice(situation.load.shape[1])
        return situation.column_of(joints, -situation.load_rate)

    @classmethod
    def effort_lag(cls, values: Values) -> float:
        """The delay."""
        return values["delay"]
