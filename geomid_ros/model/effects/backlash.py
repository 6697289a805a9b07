from __future__ import annotations

from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray


class Backlash(SituationEffect):
    """Play: the link is behind the measured position by half of c [rad], on the side that the load takes."""

    name = "backlash"
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        moved = (
            situation.by_position[:, :, joint] * situation.side[:, joint, None]
            + situation.by_velocity[:, :, joint] * situation.side_rate[:, joint, None]
            + situation.by_acceleration[:, :, joint] * situation.side_acceleration[:, joint, None]
        )
        result: FloatArray = -0.5 * moved[:, :, None]
        return result
