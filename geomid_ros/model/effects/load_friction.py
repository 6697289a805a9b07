from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import SituationEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.model.effects.places import Place, joint_of
from geomid_ros.model.effects.situation import Situation
from geomid_ros.types import FloatArray


class LoadFriction(SituationEffect):
    """Friction in proportion to the effort that the gear transmits: effort ``c |tau| sign(v)``."""

    name = "load_friction"
    label = "friction in proportion to the load"
    meaning = "effort coefficient |tau| sign(v)"
    parameters = (ParameterForm("coefficient", ("-", "-"), above=0.0, below=1.0),)
    settled_by = "the same motion with a known payload and without"
    largest = 1.0  # nothing of the effort would pass

    @property
    def positives(self) -> int:
        """It is no motor."""
        return 1

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        joint = joint_of(place)
        return situation.column_of(joint, np.abs(situation.load[:, joint]) * situation.sign[:, joint])

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """In proportion to the load."""
        return abs(coefficient) * np.abs(load)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:
        """The coefficient."""
        return values["coefficient"]
