from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.model.effects.situation import Situation, SituationEffect
from geomid_ros.types import FloatArray

CROSSINGS = tuple(float(time) for time in np.geomspace(0.003, 0.2, 15).round(4))
"""Times [s] that the usual load takes from one side of the play to the other, against the drag in the gear."""


@dataclass(frozen=True)
class Backlash(SituationEffect):
    """Play: the link is behind the measured position by half of c [rad], on the side to which the load has pushed it;
    it crosses the play in :data:`CROSSINGS` of ``crossing``."""

    crossing: int

    name = "backlash"
    label = "backlash"
    meaning = "play of gap in all between measured (motor) and link position, crossed at the speed tau/drag"
    parameters = (
        ParameterForm("gap", ("rad", "m"), above=0.0, mjcf="backlash/range"),
        ParameterForm("drag", ("N m s/rad", "N s/m"), above=0.0, optional=True, mjcf="backlash/damping"),
    )
    settled_by = "slow motions in which the load of this joint changes its sign"
    positive = True

    def columns(self, situation: Situation, joint: int) -> FloatArray:
        moved = (
            situation.by_position[:, :, joint] * situation.side[:, joint, self.crossing, None]
            + situation.by_velocity[:, :, joint] * situation.side_rate[:, joint, self.crossing, None]
            + situation.by_acceleration[:, :, joint] * situation.side_acceleration[:, joint, self.crossing, None]
        )
        result: FloatArray = -0.5 * moved[:, :, None]
        return result
