"""Predicted efforts at the rate of the messages, while the others wait to be taken many at once."""

from __future__ import annotations

import time
from array import array

from rclpy.node import Node
from sensor_msgs.msg import JointState

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.inbox import Received
from geomid_ros.live.stream import Predicted, Stream
from geomid_ros.ros.inputs import Inputs
from geomid_ros.ros.outputs import ros_time
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES

_PERIOD = 4e-3  # [s] between looks for messages: each costs as much as a message


class Streaming:
    """Publishes ``~/streamed_joint_states`` while anybody subscribes, and keeps the messages for the worker."""

    def __init__(self, node: Node, inputs: Inputs) -> None:
        """
        Args:
            node: publishes.
            inputs: where messages wait.
        """
        self._inputs = inputs
        self._publisher = node.create_publisher(JointState, "~/streamed_joint_states", 1000)
        self._stream = Stream()
        self._early: list[Received] = []

    def use(self, session: Session, estimate: Estimate) -> None:
        """Predict by an estimate from now on, in any thread."""
        self._stream.use(session, estimate)

    def forget(self) -> None:
        """Predict nothing until there is another estimate."""
        self._stream.forget()

    def waiting(self) -> list[Received]:
        """All messages that nobody has taken yet."""
        messages, self._early = [*self._early, *self._inputs.waiting()], []
        return messages

    def wait(self, seconds: float) -> None:
        """Let time pass, and predict what comes meanwhile. Raises what a prediction raises; then there are no more."""
        end = time.monotonic() + seconds
        while self._stream.ready and self._publisher.get_subscription_count() and time.monotonic() < end:
            time.sleep(_PERIOD)
            self._predict()
        time.sleep(max(0.0, end - time.monotonic()))

    def _predict(self) -> None:
        messages = self._inputs.waiting()
        self._early += messages
        try:
            for predicted in self._stream.predict([m.data for m in messages if m.topic == JOINT_STATES]):
                self._publisher.publish(_message(predicted))
        except Exception:
            self.forget()
            raise


def _message(predicted: Predicted) -> JointState:
    message = JointState()
    message.header.stamp = ros_time(predicted.stamp)
    message.name = list(predicted.joints)
    message.position = array("d", predicted.motion[0])
    message.velocity = array("d", predicted.motion[1])
    message.effort = array("d", predicted.effort)
    return message
