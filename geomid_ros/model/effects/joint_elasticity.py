from __future__ import annotations

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class JointElasticity(SituationEffect):
    """A gear that gives: the link is behind the measured position by ``c tau``, c the compliance [rad/(N m)]."""

    name = "joint_elasticity"
    label = "an elastic gear"
    meaning = "link position = measured (motor) position - tau/stiffness"
    parameters = (ParameterForm("stiffness", ("N m/rad", "N/m"), above=0.0, mjcf="elasticity/stiffness"),)
    settled_by = "faster motions, or an encoder on the link's side"
    adds_up = False
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        moved = (
            situation.by_position[:, :, joint] * situation.load[:, joint, None]
            + situation.by_velocity[:, :, joint] * situation.load_rate[:, joint, None]
            + situation.by_acceleration[:, :, joint] * situation.load_acceleration[:, joint, None]
        )
        result: FloatArray = -moved[:, :, None]
        return result
