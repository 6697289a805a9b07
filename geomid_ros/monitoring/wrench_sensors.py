"""Whether wrench sensors are what they are declared to be, and still what they were.

The force on a sensor inside the chain points where the weight and the acceleration of what it carries point, whatever
that weighs. So measured forces that are opposite to those that the URDF predicts, or turned against them, tell of a
wrong sign or frame, and forces a hundred times as large or small tell of a wrong unit, long before any mass is
identified. A payload that the URDF does not have changes none of that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.monitoring.change_detection import LATE, ChannelGap
from geomid_ros.types import FloatArray

_ENOUGH = 60  # instants in motion
_FORCES = ("fx", "fy", "fz")
_ALIGNED = 0.8  # correlation of forces that agree in direction
_ASTRAY = 0.6  # and of forces that do not
_OTHER_UNIT = 50.0  # times as large, or as small: no payload is


def sensor_channels(model: MeasurementModel) -> dict[str, list[int]]:
    """The places among the model's channels of each mounted sensor's axes, by its topic."""
    return {sensor.topic: list(model.layout.wrenches[sensor.topic]) for sensor in model.mounted}


class WrenchCheck:
    """Compares the mounted sensors' first forces with those of the URDF: sign, axes and unit.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, model: MeasurementModel, nominal: FloatArray) -> None:
        """
        Args:
            model: has the sensors.
            nominal: ``(D,)`` the URDF's parameters.
        """
        self._nominal = nominal
        channels = sensor_channels(model)
        self._forces = {
            sensor.topic: [channels[sensor.topic][sensor.axes.index(axis)] for axis in _FORCES]
            for sensor in model.mounted
            if set(_FORCES) <= set(sensor.axes)
        }
        self._count = 0
        self._products = {topic: np.zeros((6, 6)) for topic in self._forces}
        self.problems: dict[str, str] = {}
        """What is wrong with each sensor that is not as declared, by its topic."""

    @property
    def ended(self) -> bool:
        """Whether the sensors have been judged, or there are none to judge."""
        return self._count >= _ENOUGH or not self._forces

    def add(self, rows: Rows) -> None:
        """Take rows of instants in motion, until there are enough."""
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
            self.problems = {topic: problem for topic, problem in judged.items() if problem}


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
        return "the forces are opposite to those expected from the URDF: check the sign"
    if agreement < _ASTRAY and turned > _ALIGNED:
        return "the forces are rotated against those expected from the URDF: check the frame"
    ratio = float(np.sqrt(measured / expected))
    if agreement > _ALIGNED and not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        return f"the forces are {ratio:.2g} times those expected from the URDF: check the unit"
    return ""


def changed_sensors(gaps: Sequence[ChannelGap], model: MeasurementModel) -> dict[str, int] | None:
    """The mounted sensors that are no longer what they were.

    A load that is picked up is felt by other sensors and at the joints, too: where there is a gap at any other channel,
    or no other is watched, it may be the robot that has changed.

    Args:
        gaps: of the channels that are watched.
        model: has the sensors.

    Returns:
        By the topic of each changed sensor, the number of the instant before which it had not changed; None if it may
        be the robot that has.
    """
    mounted = _channels_by_topic(model)
    first = {gap.channel: gap.first for gap in gaps if gap.since is not None}
    begin = {
        topic: min(first[name] for name in names if name in first) - LATE
        for topic, names in mounted.items()
        if not first.keys().isdisjoint(names)
    }
    others = {gap.channel for gap in gaps}.difference(*mounted.values())
    return begin if others and not robot_may_have_changed(gaps, model) else None


def robot_may_have_changed(gaps: Sequence[ChannelGap], model: MeasurementModel) -> bool:
    """Whether there is a gap at a joint, or at several sensors. As long as no joint is watched yet, nobody knows."""
    mounted = _channels_by_topic(model)
    opened = {gap.channel for gap in gaps if gap.since is not None}
    return bool(opened.difference(*mounted.values())) or sum(map(bool, map(opened.intersection, mounted.values()))) > 1


def _channels_by_topic(model: MeasurementModel) -> dict[str, list[str]]:
    return {topic: [model.channels[place].name for place in places] for topic, places in sensor_channels(model).items()}
