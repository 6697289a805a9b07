"""A few serialised messages to record."""

from __future__ import annotations

import numpy as np
from rosbags.typesys import Stores, get_typestore

_TYPES = get_typestore(Stores.ROS2_JAZZY)
CHANNELS = (
    ("/joint_states", "sensor_msgs/msg/JointState"),
    ("/wrench", "geometry_msgs/msg/WrenchStamped"),
    ("/robot_description", "std_msgs/msg/String"),
    ("/odom", "nav_msgs/msg/Odometry"),
)
START = 1_700_000_000_000_000_000


def serialised(channel: int, time: int) -> bytes:
    """A message of a channel at a time [ns]."""
    kind = CHANNELS[channel][1]
    types = _TYPES.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9), frame_id="tool"
    )
    vector = types["geometry_msgs/msg/Vector3"]
    twist = types["geometry_msgs/msg/Twist"](linear=vector(x=1.0, y=2.0, z=3.0), angular=vector(x=1.0, y=2.0, z=3.0))
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    covariance = np.zeros(36)
    fields = (
        {
            "header": header,
            "name": ["joint1", "joint2", "joint3"],
            "position": np.array([0.1, 0.2, time % 1000 * 1e-3]),
            "velocity": np.array([1.0, 2.0, 3.0]),
            "effort": np.array([5.0, 6.0, 7.0]),
        },
        {
            "header": header,
            "wrench": types["geometry_msgs/msg/Wrench"](
                force=vector(x=1.0, y=2.0, z=3.0), torque=vector(x=1.0, y=2.0, z=3.0)
            ),
        },
        {"data": "<robot name='r'><link name='l'/></robot>"},
        {
            "header": header,
            "child_frame_id": "base",
            "pose": types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
            "twist": types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
        },
    )[channel]
    return bytes(_TYPES.serialize_cdr(types[kind](**fields), kind))
