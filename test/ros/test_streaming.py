"""Streamed messages are written as bytes: ROS reads what was meant."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from geomid_ros.live.stream import Predicted
from geomid_ros.ros.streaming import serialised


@pytest.mark.parametrize("joints", [("a",), ("ab",), ("joint1", "j2", "joint_33"), tuple(f"j{n}" for n in range(30))])
def test_bytes_are_those_of_messages(joints: tuple[str, ...]) -> None:
    random, stamps = np.random.default_rng(0), np.array([1_700_000_000_123_456_789, 5, 999_999_999])
    predicted = Predicted(joints, stamps, random.normal(size=(3, 3, len(joints))), random.normal(size=(3, len(joints))))
    messages = [deserialize_message(data, JointState) for data in serialised(predicted)]
    assert [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages] == stamps.tolist()
    assert all(tuple(message.name) == joints for message in messages)
    np.testing.assert_array_equal([message.position for message in messages], predicted.motion[0])
    np.testing.assert_array_equal([message.velocity for message in messages], predicted.motion[1])
    np.testing.assert_array_equal([message.effort for message in messages], predicted.efforts)
