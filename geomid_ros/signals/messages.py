"""Messages as frozen values, parsed once on entry from a node or a bag, and the memory of recently accepted ones."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomid_ros.signals.settings import BYTES_BESIDE_NUMBERS, MOST_WAITING_BYTES
from geomid_ros.types import FloatArray, IntArray, frozen

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

    def after(self, count: int) -> AcceptedMessages:
        """Return the messages after the first ``count``."""
        return AcceptedMessages(self.topic, self.stamps[count:], self.values[count:])


class Recent:
    """Remembers what a pipeline accepted in the last ``seconds`` of its stamps, as its ``on_accepted``.

    Fewer messages are kept if they take too much memory. Any thread may call any method.
    """

    def __init__(self, seconds: float) -> None:
        self._lock = threading.RLock()
        self._nanoseconds = round(seconds * 1e9)
        self._entries: deque[AcceptedMessages] = deque()
        self._bytes = 0
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
            self._bytes += _size(accepted)
            while self._entries and (self._bytes > MOST_WAITING_BYTES or self._entries[0].stamps[-1] <= oldest):
                self._bytes -= _size(self._entries.popleft())

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entries.clear()
            self._last.clear()
            self._bytes = 0

    def entries(self) -> list[AcceptedMessages]:
        """Return all remembered messages, in their order of arrival."""
        with self._lock:
            begin = max(self._last.values(), default=0) - self._nanoseconds + 1
            return [recent for entry in self._entries if len(recent := entry.since(begin))]


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
