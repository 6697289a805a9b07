"""Channels, the measured numbers: their names and order, and the declaration of wrench sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from geomid_ros.errors import InputError, check_name
from geomid_ros.types import IntArray

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
ROLES = ("external", "mounted")
WORLD_FRAMES = ("world", "map", "odom")  # names of the frame of a floating base's poses


@dataclass(frozen=True)
class WrenchSensor:
    """A wrench topic with a declared meaning. Raises InputError for invalid values.

    Attributes:
        topic: ROS topic.
        frame: URDF link in whose frame, and about whose origin, the wrench is expressed; for a force plate (a fixed
            sensor under a floating base) one of :data:`WORLD_FRAMES`.
        role: ``external``: a known load that the surroundings put on the robot (force plate, contact); or ``mounted``,
            a sensor inside the chain: the load that the part before it puts on all that comes after it.
        axes: Measured axes out of :data:`AXES`.
        sign: -1 if the sensor reports the opposite (reaction) wrench.
        offset: Known constant error, force [N] and torque [N m] in the frame: sign * reported wrench = true wrench +
            offset.
        frame_id: Name of the frame in messages, if not the link's.
    """

    topic: str
    frame: str
    role: str
    axes: tuple[str, ...] = AXES
    sign: float = 1.0
    offset: tuple[float, ...] = (0.0,) * 6
    frame_id: str = ""

    def __post_init__(self) -> None:
        check_name("wrench role", self.role, ROLES)
        for axis in self.axes:
            check_name("wrench axis", axis, AXES)
        if not self.axes or len(set(self.axes)) < len(self.axes) or self.sign not in (1.0, -1.0):
            raise InputError(
                f"wrench '{self.topic}': at least one axis, each once, and a sign of 1 or -1 are needed, "
                f"not {', '.join(self.axes) or 'none'} and {self.sign:g}"
            )

    @property
    def axis_indices(self) -> list[int]:
        """Indices of the measured axes in (fx, fy, fz, tx, ty, tz)."""
        return [AXES.index(axis) for axis in self.axes]

    @staticmethod
    def parse(text: str) -> WrenchSensor:
        """Parse ``TOPIC:FRAME:ROLE[:AXES]``, axes separated by commas; a leading ``-`` of ROLE reverses the sign."""
        parts = text.split(":")
        if len(parts) not in (3, 4) or not all(parts):
            form = "TOPIC:FRAME:ROLE[:AXES], e.g. /wrench:tool0:mounted:fz"
            raise InputError(f"wrench '{text}' is not of the form {form}")
        axes = tuple(parts[3].split(",")) if len(parts) == 4 else AXES
        role, sign = (parts[2][1:], -1.0) if parts[2].startswith("-") else (parts[2], 1.0)
        return WrenchSensor(parts[0], parts[1], role, axes, sign)


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """One measured number: a ``joint``'s effort, with the joint's name, or an ``axis`` of the wrench of a ``topic``.

    ``columns``: indices of the parameters that it can depend on."""

    name: str
    unit: str
    columns: IntArray
    joint: int | None = None
    topic: str = ""
    axis: str = ""

    @staticmethod
    def of_wrench(topic: str, axis: str, columns: IntArray) -> Channel:
        """Return the channel of a wrench axis."""
        name, unit = f"{topic.strip('/')}/{axis}", "N" if axis[0] == "f" else "N m"
        return Channel(name=name, unit=unit, columns=columns, topic=topic, axis=axis)


@dataclass(frozen=True)
class ChannelLayout:
    """Order of the channels: the joints' ``efforts`` (all or none), the axes of ``wrenches`` by topic, and the six
    channels of a floating ``base`` whose contacts with the ground are declared."""

    efforts: range
    wrenches: Mapping[str, range]
    base: range

    @staticmethod
    def of(joints: int, sensors: Sequence[WrenchSensor], base: int = 0) -> ChannelLayout:
        """Lay out the efforts of ``joints`` joints, then ``sensors`` in order, then ``base`` axes of the base."""
        wrenches, first = {}, joints
        for sensor in sensors:
            wrenches[sensor.topic] = range(first, first + len(sensor.axes))
            first = wrenches[sensor.topic].stop
        return ChannelLayout(range(joints), wrenches, range(first, first + base))


BASE = "base"
"""Name that stands for the topic in the channels of a floating base."""


def is_wrench_channel(channel: str) -> bool:
    """True if ``channel`` is the name of a wrench channel."""
    topic, _, axis = channel.rpartition("/")
    return bool(topic) and axis in AXES


def is_of(channel: str, place: str) -> bool:
    """True if the channel is the effort of the joint ``place``, or belongs to the sensor with the topic ``place``."""
    return channel == place or channel.rpartition("/")[0] == place.strip("/")
