from __future__ import annotations

from geomid_ros.model.effects.effect import PhysicalEffect
from geomid_ros.model.effects.parameters import ParameterForm


class WrenchOffset(PhysicalEffect):
    """A constant error of a wrench sensor: one more number for each of its axes."""

    name = "wrench_offset"
    label = "an offset of the wrench sensor"
    meaning = "measured wrench = true + (fx ... tz), in the sensor's frame"
    parameters = (
        *(ParameterForm(name, ("N", "N"), optional=True) for name in ("fx", "fy", "fz")),
        *(ParameterForm(name, ("N m", "N m"), optional=True) for name in ("tx", "ty", "tz")),
    )
    settled_by = "still poses with the sensor turned to all sides"
    place = "sensor"
