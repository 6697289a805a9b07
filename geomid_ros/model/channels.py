"""The measured numbers: which there are, in which order, and what they are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from geomid_ros.model.sensors import AXES, WrenchSensor
from geomid_ros.types import IntArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """One measured number: a ``joint``'s effort, or an ``axis`` of the wrench of a ``topic``.

    ``columns``: the parameters that it can depend on."""

    name: str
    unit: str
    columns: IntArray
    joint: int | None = None
    topic: str = ""
    axis: str = ""


@dataclass(frozen=True)
class ChannelLayout:
    """The order of the channels: the joints' ``efforts``, all or none, the axes of ``wrenches`` by topic, and the six
    of a floating ``base``, if what touches the ground is known."""

    efforts: range
    wrenches: Mapping[str, range]
    base: range

    @staticmethod
    def of(joints: int, sensors: Sequence[WrenchSensor], base: int = 0) -> ChannelLayout:
        """Of the efforts of so many joints, of sensors in their order, and of so many axes of the base."""
        wrenches, first = {}, joints
        for sensor in sensors:
            wrenches[sensor.topic] = range(first, first + len(sensor.axes))
            first = wrenches[sensor.topic].stop
        return ChannelLayout(range(joints), wrenches, range(first, first + base))


BASE = "base"
"""The topic, so to say, of the channels of a floating base."""


def unit_of_axis(axis: str) -> str:
    """Of one of the axes of a wrench."""
    return "N" if axis[0] == "f" else "N m"


def wrench_channel(topic: str, axis: str) -> str:
    """The name of a channel of a wrench sensor; a joint's is that of the joint."""
    return f"{topic.strip('/')}/{axis}"


def is_wrench_channel(channel: str) -> bool:
    """Whether the channel of that name is one of a wrench sensor."""
    topic, _, axis = channel.rpartition("/")
    return bool(topic) and axis in AXES


def is_of(channel: str, place: str) -> bool:
    """Whether the channel of that name is the effort of the joint ``place``, or of the sensor with that topic."""
    return channel == place or channel.rpartition("/")[0] == place.strip("/")
