"""Reads serialised messages by ROS itself, where rosbags is not installed."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState

_CLASSES = {
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "nav_msgs/msg/Odometry": Odometry,
    "sensor_msgs/msg/Imu": Imu,
    "sensor_msgs/msg/JointState": JointState,
}


class RosTypes:
    """The types of messages that a node hears, see :func:`~geomid_ros.signals.decoding.read_without_rosbags`."""

    def deserialize_cdr(self, data: bytes, kind: str) -> Any:
        """The message of this type in ``data``. Raises what rclpy raises for bytes that are none."""
        return deserialize_message(data, _CLASSES[kind])
