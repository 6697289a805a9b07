"""Messages as frozen values: parsed one by one, or decoded to blocks of numbers; and which were accepted recently.

The layout of a serialised message serves all that differ only in numbers.
"""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.signals.settings import BYTES_BESIDE_NUMBERS, MOST_KINDS, MOST_WAITING_BYTES
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray, frozen

JOINT_STATES = "joint_states"
ODOM = "odom"
IMU = "imu"
COMMANDS = "joint_commands"
_TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    COMMANDS: "sensor_msgs/msg/JointState",
    ODOM: "nav_msgs/msg/Odometry",
    IMU: "sensor_msgs/msg/Imu",
}
_WRENCH_TYPE = "geometry_msgs/msg/WrenchStamped"


@dataclass(frozen=True, eq=False, slots=True)
class Message:
    """Message as it was sent, without checks.

    ``stamp`` [ns] since the epoch, -1 if invalid; ``names`` of the joints, or the frame of a wrench, empty if the
    message has none. ``arrays``, read-only, are: for joints, positions, velocities and efforts ``(names,)``, each of
    which may be empty, and for commands set-points and the feed-forward; the base's pose ``(7,)`` in the world,
    position [m] and quaternion xyzw; a wrench ``(6,)``, force [N] and torque [N m]; or of an IMU ``(37,)`` orientation
    (4), angular velocity (3) [rad/s] and linear acceleration (3) [m/s^2], each followed by its covariance (9).
    """

    topic: str
    stamp: int
    names: tuple[str, ...]
    arrays: tuple[FloatArray, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "arrays", tuple(map(frozen, self.arrays)))


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """N messages of one topic that differ only in stamps and numbers.

    ``order (N,)`` are arrival indices among the messages of several blocks; ``stamps (N,)`` [ns] are -1 where invalid;
    ``names`` are those of the joints, or the frame of a wrench. ``arrays`` are positions, velocities and efforts
    ``(N, names)``, each of which may have no columns, poses ``(N, 7)``, wrenches ``(N, 6)`` or all of an IMU
    ``(N, 37)``.
    """

    topic: str
    order: IntArray
    stamps: IntArray
    names: tuple[str, ...]
    arrays: tuple[FloatArray, ...]

    @staticmethod
    def of(message: Message, place: int = 0) -> Block:
        """Make a block of one message, with arrival index ``place``."""
        arrays = tuple(array[None] for array in message.arrays)
        return Block(message.topic, np.array([place]), np.array([message.stamp]), message.names, arrays)


@dataclass(frozen=True, eq=False, slots=True)
class AcceptedMessages:
    """N accepted messages of a topic: stamps [ns] and checked numbers in the robot's order, read-only.

    ``stamps (N,)``; ``values (N, numbers)`` are positions, velocities and efforts of all joints, concatenated (for
    commands, too), a pose (7 numbers), a wrench (6), or an IMU's angular velocity and specific force (6).
    """

    topic: str
    stamps: IntArray
    values: FloatArray

    def __post_init__(self) -> None:
        self.stamps.setflags(write=False)
        self.values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.stamps)

    def since(self, stamp: int) -> AcceptedMessages:
        """Return the messages with this stamp [ns] or later ones."""
        return self.after(int(np.searchsorted(self.stamps, stamp)))

    def before(self, stamp: int) -> AcceptedMessages:
        """Return the messages with earlier stamps [ns]."""
        count = int(np.searchsorted(self.stamps, stamp))
        return AcceptedMessages(self.topic, self.stamps[:count], self.values[:count])

    def without(self, begin: int, end: int) -> AcceptedMessages:
        """Return the messages but those with stamps [ns] from ``begin`` up to, but not including, ``end``."""
        kept = (self.stamps < begin) | (self.stamps >= end)
        return AcceptedMessages(self.topic, self.stamps[kept], self.values[kept])

    def after(self, count: int) -> AcceptedMessages:
        """Return the messages after the first ``count``."""
        return AcceptedMessages(self.topic, self.stamps[count:], self.values[count:])


class Recent:
    """Remembers what a pipeline accepted in the last ``seconds`` of its stamps, as its ``on_accepted``.

    Fewer messages are kept if they take too much memory, and none from before a clock was set back: stamps of two
    clocks cannot be compared. Any thread may call any method.
    """

    def __init__(self, seconds: float, sample_count: Callable[[], int] = int) -> None:
        """``sample_count``: number of samples that were made of what was accepted."""
        self._lock = threading.RLock()
        self._nanoseconds = round(seconds * 1e9)
        self._sample_count = sample_count
        self._entries: deque[AcceptedMessages] = deque()
        self._bytes = 0
        self.count = 0
        """Number of entries so far, those that were forgotten included."""
        self.first_sample = 0
        """Index of the first sample on the clock of the remembered messages."""
        self._last: dict[str, int] = {}

    def __call__(self, accepted: AcceptedMessages) -> None:
        """Remember messages."""
        topic, newest = accepted.topic, int(accepted.stamps[-1])
        oldest = newest - self._nanoseconds
        with self._lock:
            if accepted.stamps[0] <= self._last.get(topic, 0):  # the clock was set back
                self.clear()
            self._last[topic] = newest
            self._entries.append(accepted)
            self.count += 1
            self._bytes += _size(accepted)
            while self._entries and (self._bytes > MOST_WAITING_BYTES or not len(self._entries[0].since(oldest + 1))):
                self._bytes -= _size(self._entries.popleft())

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entries.clear()
            self._last.clear()
            self._bytes = 0
            self.first_sample = self._sample_count()

    def forget(self, begin: int, end: int) -> None:
        """Forget the messages with stamps [ns] from ``begin`` up to, but not including, ``end``."""
        with self._lock:
            self._entries = deque(entry.without(begin, end) for entry in self._entries)
            self._bytes = sum(map(_size, self._entries))

    def entries(self, after: int = 0) -> list[AcceptedMessages]:
        """Return the remembered messages, in their order of arrival; only those after the first ``after`` entries of
        all (:attr:`count`)."""
        with self._lock:
            begin = max(self._last.values(), default=0) - self._nanoseconds + 1
            known = max(0, after - self.count + len(self._entries))
            return [recent for entry in islice(self._entries, known, None) if len(recent := entry.since(begin))]


def _size(accepted: AcceptedMessages) -> int:
    return accepted.values.nbytes + accepted.stamps.nbytes + BYTES_BESIDE_NUMBERS


def message_type(topic: str) -> str:
    """Return the ROS type of a topic's messages; unknown topics are of wrench sensors."""
    return _TYPES.get(topic, _WRENCH_TYPE)


def parse(topic: str, message: Any) -> Message:
    """Parse a ROS message, by attributes, which the messages of rclpy and rosbags share.

    Args:
        topic: its name in the pipeline: JOINT_STATES, COMMANDS, ODOM, IMU, or that of a declared wrench sensor.
        message: message of the type :func:`message_type` of this topic.

    Raises:
        AttributeError, TypeError or ValueError: it is no such message.
    """
    stamp, names, arrays = _stamp(message.header), tuple[str, ...](), tuple[FloatArray, ...]()
    if topic in (JOINT_STATES, COMMANDS):
        names, arrays = tuple(message.name), (message.position, message.velocity, message.effort)
    elif topic == ODOM:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        arrays = (np.array((p.x, p.y, p.z, q.x, q.y, q.z, q.w)),)
    elif topic == IMU:
        arrays = (_imu_numbers(message),)
    else:
        force, torque = message.wrench.force, message.wrench.torque
        names = (message.header.frame_id,)
        arrays = (np.array((force.x, force.y, force.z, torque.x, torque.y, torque.z)),)
    return Message(topic, stamp, names, arrays)


def _imu_numbers(message: Any) -> FloatArray:
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    parts = (
        *((q.x, q.y, q.z, q.w), message.orientation_covariance),
        *((w.x, w.y, w.z), message.angular_velocity_covariance),
        *((a.x, a.y, a.z), message.linear_acceleration_covariance),
    )
    return np.concatenate(parts)


def _stamp(header: Any) -> int:
    """Return nanoseconds since the epoch; -1 if seconds or nanoseconds are out of range."""
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < 1_000_000_000:
        return -1
    return seconds * 1_000_000_000 + nanoseconds


LITTLE_ENDIAN = b"\0\1"
Raw: TypeAlias = tuple[str, bytes, *tuple[Any, ...]]
"""A message as received: its topic's name in the pipeline, its bytes (CDR), and any further data."""


_without_rosbags: list[Any] = []


def read_without_rosbags(types: Any) -> None:
    """Let ``types.deserialize_cdr(data, kind)`` read messages where rosbags is not installed, as on a robot."""
    _without_rosbags[:] = [types]


@cache
def message_types() -> Any:
    """Return the reader of messages by the definitions of ROS 2 Jazzy: ``deserialize_cdr(data, kind)``.

    Raises:
        ModuleNotFoundError: rosbags is not installed, and there is no other reader.
    """
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 where it is installed
    except ModuleNotFoundError:
        if not _without_rosbags:
            raise
        return _without_rosbags[0]
    return get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class _Layout:
    """Places of the numbers in messages of one size with the same texts and lengths.

    ``fixed`` are the places of the bytes that all messages share with ``like``, and ``text`` these bytes; ``form`` has
    the stamp in its first two fields, and then the arrays.
    """

    like: Block
    fixed: IntArray
    text: AnyArray
    form: np.dtype[np.void]

    def matches(self, data: AnyArray) -> BoolArray:
        """True for messages ``(N, size)`` with this layout ``(N,)``."""
        matching: BoolArray = (data[:, self.fixed] == self.text).all(axis=1)
        return matching

    def block(self, data: AnyArray, order: IntArray) -> Block:
        """Return the numbers of messages ``(N, size)``."""
        records = data.view(self.form)[:, 0]
        seconds, nanoseconds, *arrays = (records[field] for field in self.form.names or ())
        stamps = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
        stamps[(seconds >= 1 << 31) | (nanoseconds >= 1_000_000_000)] = -1
        return Block(self.like.topic, order, stamps, self.like.names, tuple(arrays))


class Decoder:
    """Decodes messages of several topics, and remembers their layouts."""

    def __init__(self) -> None:
        self._layouts: dict[tuple[str, int], list[_Layout]] = {}  # by topic and size

    def blocks(self, messages: Sequence[Raw], refuse: Callable[[int, str], None]) -> list[Block]:
        """Decode messages into as few blocks as possible.

        Args:
            messages: messages in their order of arrival.
            refuse: ``refuse(place, why)`` receives messages that are not of their topic's type.
        """
        groups: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
        for place, message in enumerate(messages):
            groups[message[0], len(message[1])].append(place)
        return [block for group, places in groups.items() for block in self._decoded(group, places, messages, refuse)]

    def _decoded(
        self,
        group: tuple[str, int],
        places: list[int],
        messages: Sequence[Raw],
        refuse: Callable[[int, str], None],
    ) -> list[Block]:
        """Decode the messages of one topic and size."""
        data = np.frombuffer(b"".join([messages[place][1] for place in places]), np.uint8).reshape(len(places), -1)
        remaining, blocks = np.array(places), []
        layouts = deque(self._layouts.get(group, ()))
        while len(remaining):
            if not layouts:
                place = int(remaining[0])
                data, remaining = data[1:], remaining[1:]
                try:
                    block, layout = _parsed(messages[place], place)
                except ValueError as error:
                    refuse(place, str(error))
                    continue
                blocks.append(block)
                if layout is not None:
                    self._remember(group, layout)
                    layouts.append(layout)
            else:
                layout = layouts.popleft()
                same = layout.matches(data)
                if same.any():
                    blocks.append(layout.block(data[same], remaining[same]))
                    data, remaining = data[~same], remaining[~same]
        return blocks

    def _remember(self, group: tuple[str, int], layout: _Layout) -> None:
        if sum(map(len, self._layouts.values())) >= MOST_KINDS:  # bounded, as the sender decides how many there are
            self._layouts.clear()
        self._layouts.setdefault(group, []).append(layout)


def _parsed(raw: Raw, place: int) -> tuple[Block, _Layout | None]:
    """Parse a message. Return it and its layout, None if that is not understood. Raises ValueError with the reason."""
    topic, data, *_ = raw
    types = message_types()
    try:
        message = types.deserialize_cdr(data, message_type(topic))
        block = Block.of(parse(topic, message), place)
    except Exception as error:  # parsing malformed bytes may raise anything
        raise ValueError((str(error).splitlines() or [type(error).__name__])[0]) from error
    if data[:2] != LITTLE_ENDIAN:
        return block, None
    return block, _layout(topic, data, message, block)


def _layout(topic: str, data: bytes, message: Any, block: Block) -> _Layout | None:
    """Return the layout of a message; None if its numbers are not at the expected places."""
    fixed, place = [slice(0, 2)], 12
    texts = [message.header.frame_id, *([message.child_frame_id] if topic == ODOM else ())]
    for text in texts:
        place = _after_text(place, text, fixed)
    if topic in (JOINT_STATES, COMMANDS):
        place = _after_count(place, fixed)
        for text in message.name:
            place = _after_text(place, text, fixed)
    formats: list[Any] = ["<u4", "<u4"]  # seconds and nanoseconds
    offsets = [4, 8]
    for array in block.arrays:
        if topic in (JOINT_STATES, COMMANDS):
            place = _after_count(place, fixed)
        count = array.shape[1]
        begin = _aligned(place, 8) if count else place
        formats.append(("<f8", (count,)))
        offsets.append(begin)
        place = begin + 8 * count
    places = np.concatenate([np.arange(part.start, part.stop) for part in fixed])
    if place > len(data):
        return None
    record = np.frombuffer(data, np.uint8)[None]
    names = [*map(str, range(len(formats)))]
    form = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(data)})
    layout = _Layout(block, places, record[0, places], form)
    decoded = layout.block(record, block.order)
    same = all(a.tobytes() == b.tobytes() for a, b in zip(decoded.arrays, block.arrays, strict=True))
    return layout if same and decoded.stamps[0] == block.stamps[0] else None


def _aligned(place: int, size: int) -> int:
    """Next place of a number of this size; CDR counts from the fifth byte."""
    return place + (4 - place) % size


def _after_text(place: int, text: str, fixed: list[slice]) -> int:
    begin = _aligned(place, 4)
    fixed.append(slice(begin, begin + 4 + len(text.encode()) + 1))
    return int(fixed[-1].stop)


def _after_count(place: int, fixed: list[slice]) -> int:
    begin = _aligned(place, 4)
    fixed.append(slice(begin, begin + 4))
    return begin + 4
