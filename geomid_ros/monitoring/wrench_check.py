"""Whether a wrench sensor's messages mean what its declaration says: sign, axes and unit, by the URDF's gravity.

The force on a sensor inside the chain points where the weight and the acceleration of what it carries point, whatever
that weighs. So measured forces that are opposite to, or turned against, those that the URDF lets expect tell of a sign
or a frame, and forces a hundred times as large or small tell of a unit, long before any mass is identified. A payload
that the URDF does not have changes none of that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.measurement import Channel, Rows
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.types import FloatArray

_ENOUGH = 60  # instants in motion
_FORCES = ("fx", "fy", "fz")
_ALIGNED = 0.8  # correlation of forces that agree in direction
_ASTRAY = 0.6  # and of forces that do not
_OTHER_UNIT = 50.0  # times as large, or as small: no payload is


class WrenchCheck:
    """Judges the wrench sensors by their first rows. One thread may call :meth:`add` while another asks."""

    def __init__(self, channels: Sequence[Channel], sensors: Sequence[WrenchSensor], nominal: FloatArray) -> None:
        """``nominal (D,)``: the URDF's parameters."""
        self._nominal = nominal
        places = {channel.name: place for place, channel in enumerate(channels)}
        self._forces = {
            sensor.topic: [places[f"{sensor.topic.strip('/')}/{axis}"] for axis in _FORCES]
            for sensor in sensors
            if sensor.role == "mounted" and set(_FORCES) <= set(sensor.axes)
        }
        self._count = 0
        self._products = {topic: np.zeros((6, 6)) for topic in self._forces}
        self._problems: dict[str, str] = {}

    @property
    def ended(self) -> bool:
        """Whether it is known what is wrong."""
        return self._count >= _ENOUGH or not self._forces

    @property
    def problems(self) -> dict[str, str]:
        """What is wrong, by the topic of the sensor."""
        return self._problems

    def add(self, rows: Rows) -> None:
        """Take rows of instants in motion; after the first ones nothing is done any more."""
        if self.ended:
            return
        self._count += len(rows.targets)
        for topic, places in self._forces.items():
            expected = rows.coefficients[:, places] @ self._nominal
            both = np.concatenate([rows.targets[:, places], expected], axis=1)
            both = both[np.all(np.isfinite(both), axis=1)]
            self._products[topic] += both.T @ both
        if self._count >= _ENOUGH:
            judged = {topic: _judged(products) for topic, products in self._products.items()}
            self._problems = {topic: problem for topic, problem in judged.items() if problem}


def _judged(products: FloatArray) -> str:
    """What is wrong with a sensor, by the summed products ``(6, 6)`` of measured and expected forces."""
    measured, expected = np.trace(products[:3, :3]), np.trace(products[3:, 3:])
    if not measured > 0.0 or not expected > 0.0:
        return ""
    scale = float(np.sqrt(measured * expected))
    left, strengths, right = np.linalg.svd(products[:3, 3:])
    agreement = float(np.trace(products[:3, 3:])) / scale
    handed = np.linalg.det(left @ right)
    turned = float(strengths[0] + strengths[1] + np.sign(handed) * strengths[2]) / scale
    if agreement < -_ALIGNED:
        return "the forces are opposite to those expected from the URDF: is the sign reversed?"
    if agreement < _ASTRAY and turned > _ALIGNED:
        return "the forces are turned against those expected from the URDF: is the frame another one?"
    ratio = float(np.sqrt(measured / expected))
    if agreement > _ALIGNED and not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        return f"the forces are {ratio:.2g} times those expected from the URDF: is the unit another one?"
    return ""
