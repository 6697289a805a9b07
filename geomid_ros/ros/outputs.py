"""The node's publishers of results."""

from __future__ import annotations

import json

from geometry_msgs.msg import InertiaStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import with_identified_inertias
from geomid_ros.live.gap_search import SearchStatus
from geomid_ros.model.samples import Samples
from geomid_ros.ros.messages import inertia_message, marker_message, predicted_message
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


def latched(depth: int = 1) -> QoSProfile:
    """The last messages are kept for those who come late."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


class Outputs:
    """Publishes inertias, predicted efforts, the identified URDF, markers and findings, from any thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._inertias = node.create_publisher(InertiaStamped, "~/inertias", latched(256))
        self._predicted = node.create_publisher(JointState, "~/predicted_joint_states", 1000)
        self._identified = node.create_publisher(String, "~/robot_description", latched())
        self._markers = node.create_publisher(MarkerArray, "~/markers", latched())
        self._findings = node.create_publisher(String, "~/gap", latched())

    def prediction(self, session: Session, samples: Samples, parameters: FloatArray) -> None:
        """Publish the efforts that parameters predict for samples, if anybody listens."""
        if self._predicted.get_subscription_count() == 0:
            return
        efforts = session.model.predicted_efforts(samples, parameters)
        for index in range(len(samples)):
            self._predicted.publish(predicted_message(session.robot, samples, index, efforts[index]))

    def estimate(self, session: Session, estimate: Estimate) -> None:
        """Publish an estimate."""
        stamp = self._node.get_clock().now().nanoseconds
        for link in estimate.links:
            self._inertias.publish(inertia_message(link, stamp))
        self._identified.publish(String(data=with_identified_inertias(session.urdf, estimate.links)))
        self._markers.publish(marker_message(estimate.links, stamp))

    def finding(self, status: SearchStatus) -> None:
        """Publish how a search for a gap ended."""
        self._findings.publish(String(data=json.dumps(status.document, indent=2)))
        self._node.get_logger().info(status.sentence)
