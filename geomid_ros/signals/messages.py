"""Reads ROS messages into a pipeline, by attribute: rclpy's message classes and those of rosbags look the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from geomid_ros.signals.pipeline import SignalPipeline

MESSAGE_TYPES = {
    "joint_states": "sensor_msgs/msg/JointState",
    "odom": "nav_msgs/msg/Odometry",
    "wrench": "geometry_msgs/msg/WrenchStamped",
}


class _Stamp(Protocol):
    sec: int
    nanosec: int


class Header(Protocol):
    """std_msgs/Header."""

    stamp: _Stamp
    frame_id: str


class JointState(Protocol):
    """sensor_msgs/JointState."""

    header: Header
    name: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]


class Odometry(Protocol):
    """nav_msgs/Odometry."""

    header: Header
    pose: Any


class WrenchStamped(Protocol):
    """geometry_msgs/WrenchStamped."""

    header: Header
    wrench: Any


def stamp_of(header: Header) -> int:
    """A header's stamp in nanoseconds since the epoch; -1 if its parts are out of range."""
    seconds, nanoseconds = int(header.stamp.sec), int(header.stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < 1_000_000_000:
        return -1
    return seconds * 1_000_000_000 + nanoseconds


def feed_joint_state(pipeline: SignalPipeline, message: JointState) -> None:
    """Pass a joint message on."""
    pipeline.push_joints(stamp_of(message.header), message.name, message.position, message.velocity, message.effort)


def feed_odometry(pipeline: SignalPipeline, message: Odometry) -> None:
    """Pass a base pose on."""
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    pipeline.push_base_pose(
        stamp_of(message.header),
        (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w),
    )


def feed_wrench(pipeline: SignalPipeline, topic: str, message: WrenchStamped) -> None:
    """Pass a wrench on; ``topic`` is the name by which the sensor was declared."""
    force, torque = message.wrench.force, message.wrench.torque
    pipeline.push_wrench(
        topic,
        stamp_of(message.header),
        message.header.frame_id,
        (force.x, force.y, force.z, torque.x, torque.y, torque.z),
    )
