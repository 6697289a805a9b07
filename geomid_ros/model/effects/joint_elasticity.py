from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import Effect, Hinge, SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.situation import Place, Situation, joint_of
from geomid_ros.types import FloatArray

_DAMPING_RATIO = 0.05  # of the link on the elastic gear, the motor held


class JointElasticity(SituationEffect):
    """A gear that gives: the link is behind the measured position by ``c tau``, c the compliance [rad/(N m)]."""

    name = "joint_elasticity"
    label = "an elastic gear"
    meaning = "link position = measured (motor) position - tau/stiffness"
    parameters = (ParameterForm("stiffness", ("N m/rad", "N/m"), above=0.0, mjcf="elasticity/stiffness"),)
    settled_by = "faster motion, or an encoder on the link side"
    adds_up = False
    like_a_payload = True
    largest = 1.0  # [rad/(N m)]

    @property
    def positives(self) -> int:
        """The compliance."""
        return 1

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        loads = (situation.load, situation.load_rate, situation.load_acceleration)
        return situation.behind(joint, *(load[:, joint] for load in loads))

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The stiffness."""
        return 1.0 / coefficients, np.array([[-1.0 / coefficients[0] ** 2]])

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:  # noqa: ARG003
        """The compliance."""
        return {cls(): (1.0 / values["stiffness"],)}

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge:
        """A spring between the motor and the link."""
        stiffness = values["stiffness"]
        damping = 2.0 * _DAMPING_RATIO * float(np.sqrt(stiffness * carried))
        return Hinge("elasticity", stiffness=stiffness, damping=damping)
