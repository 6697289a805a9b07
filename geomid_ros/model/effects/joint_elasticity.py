from __future__ import annotations

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class JointElasticity(SituationEffect):
    """A gear that gives: the link is behind the measured position by ``c tau``, c the compliance [rad/(N m)]."""

    name = "joint_elasticity"
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        moved = (
            situation.by_position[:, :, joint] * situation.load[:, joint, None]
            + situation.by_velocity[:, :, joint] * situation.load_rate[:, joint, None]
            + situation.by_acceleration[:, :, joint] * situation.load_acceleration[:, joint, None]
        )
        result: FloatArray = -moved[:, :, None]
        return result
