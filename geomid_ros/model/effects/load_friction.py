from __future__ import annotations

import numpy as np

from geomid_ros.model.effects.effect import FRICTION_DRIFT, LoadEffect
from geomid_ros.model.effects.parameters import ParameterForm, Values
from geomid_ros.types import FloatArray


class LoadFriction(LoadEffect):
    """Friction in proportion to the effort that the gear transmits: effort ``c |tau| sign(v)``."""

    name = "load_friction"
    label = "load-dependent friction"
    meaning = "effort coefficient |tau| sign(v)"
    parameters = (ParameterForm("coefficient", ("-", "-"), above=0.0, below=1.0),)
    settled_by = "the same motion with and without a known payload"
    drift = FRICTION_DRIFT
    largest = 1.0  # nothing of the effort would pass

    @property
    def positives(self) -> int:
        """It is no motor."""
        return 1

    def column(self, load: FloatArray, sign: FloatArray) -> FloatArray:
        return np.abs(load) * sign

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """In proportion to the load."""
        return abs(coefficient) * np.abs(load)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:
        """The coefficient."""
        return values["coefficient"]
