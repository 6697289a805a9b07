"""Messages as frozen values: parsed once at the door, whether a node or a bag brings them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

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


class _ReadOnly:
    """Makes the arrays of a frozen dataclass read-only copies."""

    __slots__ = ()
    _arrays: ClassVar[tuple[str, ...]]

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """Its numbers, in the order of the fields."""
        return tuple(getattr(self, name) for name in self._arrays)

    def __post_init__(self) -> None:
        for name in self._arrays:
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, eq=False, slots=True)
class JointMessage(_ReadOnly):
    """Positions, velocities and efforts of joints.

    ``stamp`` [ns] since the epoch, -1 if it is not valid. ``position``, ``velocity``, ``effort (names,)`` are what the
    driver sent: any may be empty, and nothing is checked yet.
    """

    topic: ClassVar[str] = JOINT_STATES
    _arrays: ClassVar[tuple[str, ...]] = ("position", "velocity", "effort")
    stamp: int
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


class CommandMessage(JointMessage):
    """Set-points of joints, and as efforts the feed-forward; any but the positions may be empty."""

    __slots__ = ()
    topic: ClassVar[str] = COMMANDS


@dataclass(frozen=True, eq=False, slots=True)
class PoseMessage(_ReadOnly):
    """The base's ``pose (7,)`` in the world: position [m] and quaternion xyzw; ``stamp`` as of joints."""

    topic: ClassVar[str] = ODOM
    _arrays: ClassVar[tuple[str, ...]] = ("pose",)
    stamp: int
    pose: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class WrenchMessage(_ReadOnly):
    """The ``wrench (6,)``, force [N] and torque [N m], of a sensor's ``topic``, expressed in ``frame`` (as the message
    says, empty if it does not); ``stamp`` as of joints."""

    _arrays: ClassVar[tuple[str, ...]] = ("wrench",)
    topic: str
    stamp: int
    frame: str
    wrench: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class ImuMessage(_ReadOnly):
    """All ``numbers (37,)`` of an IMU's message: orientation (4), angular velocity (3) [rad/s] and linear acceleration
    (3) [m/s^2], each followed by its covariance (9); ``stamp`` as of joints."""

    topic: ClassVar[str] = IMU
    _arrays: ClassVar[tuple[str, ...]] = ("numbers",)
    stamp: int
    numbers: FloatArray


Message: TypeAlias = JointMessage | PoseMessage | WrenchMessage | ImuMessage


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """N messages of one topic that differ in their stamps and numbers only.

    ``order (N,)`` says in which order the messages of several blocks came; ``stamps (N,)`` [ns] are -1 where they are
    not valid; ``names`` are those of the joints, or the frame of a wrench. ``arrays`` are positions, velocities and
    efforts ``(N, names)``, each of which may have no columns, poses ``(N, 7)``, wrenches ``(N, 6)`` or all of an IMU
    ``(N, 37)``.
    """

    topic: str
    order: IntArray
    stamps: IntArray
    names: tuple[str, ...]
    arrays: tuple[FloatArray, ...]

    @staticmethod
    def of(message: Message, place: int = 0) -> Block:
        """A block of one message, the ``place``-th that came."""
        names = message.names if isinstance(message, JointMessage) else ()
        names = (message.frame,) if isinstance(message, WrenchMessage) else names
        arrays = tuple(array[None] for array in message.arrays)
        return Block(message.topic, np.array([place]), np.array([message.stamp]), names, arrays)


@dataclass(frozen=True, eq=False, slots=True)
class Accepted:
    """N messages that were accepted: their topic, stamps [ns] and checked numbers in the robot's order, read-only.

    ``stamps (N,)``; ``values (N, numbers)`` are positions, velocities and efforts of all joints, one after the other
    (of commands, too), a pose (7 numbers), a wrench (6), or an IMU's angular velocity and specific force (6).
    """

    topic: str
    stamps: IntArray
    values: FloatArray

    def __post_init__(self) -> None:
        self.stamps.setflags(write=False)
        self.values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.stamps)

    def since(self, stamp: int) -> Accepted:
        """Those with this stamp [ns] or a later one."""
        return self.after(int(np.searchsorted(self.stamps, stamp)))

    def before(self, stamp: int) -> Accepted:
        """Those with an earlier stamp [ns]."""
        count = int(np.searchsorted(self.stamps, stamp))
        return Accepted(self.topic, self.stamps[:count], self.values[:count])

    def after(self, count: int) -> Accepted:
        """Those after the first ``count``."""
        return Accepted(self.topic, self.stamps[count:], self.values[count:])


def message_type(topic: str) -> str:
    """The ROS type of a topic's messages; all topics but these are of wrench sensors."""
    return _TYPES.get(topic, _WRENCH_TYPE)


def parse(topic: str, message: Any) -> Message:
    """The value of a ROS message, read by attribute: rclpy's messages and those of rosbags look the same.

    Args:
        topic: the name by which the pipeline knows it: JOINT_STATES, COMMANDS, ODOM, IMU, or that of a declared wrench
            sensor.
        message: of the type :func:`message_type` of this topic.

    Raises:
        AttributeError, TypeError or ValueError for what is no such message.
    """
    header = message.header
    if topic in (JOINT_STATES, COMMANDS):
        kind = JointMessage if topic == JOINT_STATES else CommandMessage
        return kind(_stamp(header), tuple(message.name), message.position, message.velocity, message.effort)
    if topic == ODOM:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        return PoseMessage(_stamp(header), np.array((p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
    if topic == IMU:
        return ImuMessage(_stamp(header), _imu_numbers(message))
    force, torque = message.wrench.force, message.wrench.torque
    wrench = np.array((force.x, force.y, force.z, torque.x, torque.y, torque.z))
    return WrenchMessage(topic, _stamp(header), header.frame_id, wrench)


def _imu_numbers(message: Any) -> FloatArray:
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    parts = (
        *((q.x, q.y, q.z, q.w), message.orientation_covariance),
        *((w.x, w.y, w.z), message.angular_velocity_covariance),
        *((a.x, a.y, a.z), message.linear_acceleration_covariance),
    )
    return np.concatenate(parts)


def _stamp(header: Any) -> int:
    """Nanoseconds since the epoch; -1 if seconds or nanoseconds are out of range."""
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < 1_000_000_000:
        return -1
    return seconds * 1_000_000_000 + nanoseconds
