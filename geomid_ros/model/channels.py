"""The measured numbers: which there are, in which order, what they are called, and what a wrench sensor's mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.types import IntArray

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
ROLES = {
    "external": "a known load that the surroundings put on the robot (force plate, contact)",
    "mounted": "a sensor inside the chain: the load that the part before it puts on all that comes after it",
}
WORLD_FRAMES = ("world", "map", "odom")  # names of the frame in which the poses of a floating base are given


@dataclass(frozen=True)
class WrenchSensor:
    """A wrench topic with a declared meaning. Raises InputError for values that cannot be.

    Attributes:
        topic: Where it is published.
        frame: The URDF link in whose frame, and about whose origin, the wrench is expressed; for a force plate (a
            fixed sensor under a floating base) one of :data:`WORLD_FRAMES`.
        role: One of :data:`ROLES`.
        axes: Those of :data:`AXES` that are measured.
        sign: -1 if the sensor reports the opposite (reaction) wrench.
        offset: Known constant error, force [N] and torque [N m] in the frame: sign times the reported wrench is the
            true one plus this.
        frame_id: The frame's name in messages, if it is not the link's.
    """

    topic: str
    frame: str
    role: str
    axes: tuple[str, ...] = AXES
    sign: float = 1.0
    offset: tuple[float, ...] = (0.0,) * 6
    frame_id: str = ""

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise unknown_name("wrench role", self.role, ROLES)
        for axis in self.axes:
            if axis not in AXES:
                raise unknown_name("wrench axis", axis, AXES)
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
        """From ``TOPIC:FRAME:ROLE[:AXES]``, axes separated by commas; a leading ``-`` of ROLE reverses the sign."""
        parts = text.split(":")
        if len(parts) not in (3, 4) or not all(parts):
            form = "TOPIC:FRAME:ROLE[:AXES], e.g. /wrench:tool0:mounted:fz"
            raise InputError(f"wrench '{text}' is not of the form {form}")
        axes = tuple(parts[3].split(",")) if len(parts) == 4 else AXES
        role, sign = (parts[2][1:], -1.0) if parts[2].startswith("-") else (parts[2], 1.0)
        return WrenchSensor(parts[0], parts[1], role, axes, sign)


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
