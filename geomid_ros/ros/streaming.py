"""Predicted efforts at the rate of the messages, while the others wait to be taken many at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.inbox import Received
from geomid_ros.live.stream import Predicted, Stream
from geomid_ros.monitoring.payload_watch import Carried
from geomid_ros.ros.inputs import Inputs
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.types import AnyArray

_PERIOD = 5e-3  # [s] between looks for messages: each costs as much as a message


class Streaming:
    """Publishes ``~/streamed_joint_states`` while anybody subscribes, and keeps the messages for the worker."""

    def __init__(self, node: Node, inputs: Inputs, warn: Callable[[str], None]) -> None:
        """
        Args:
            node: publishes.
            inputs: where messages wait.
            warn: is told why something is not streamed.
        """
        self._inputs = inputs
        self._publisher = node.create_publisher(JointState, "~/streamed_joint_states", 1000)
        self._stream = Stream()
        self._early: list[Received] = []
        self._warn = warn
        self._said: set[str] = set()

    def use(self, session: Session, estimate: Estimate) -> None:
        """Predict by an estimate from now on, in any thread."""
        self._stream.use(session, estimate)

    def carry(self, carried: Carried | None) -> None:
        """Add a payload to the robot from now on, or none, in any thread."""
        self._stream.carry(carried)

    def forget(self) -> None:
        """Predict nothing until there is another estimate."""
        self._stream.forget()
        self._said.clear()

    def waiting(self) -> list[Received]:
        """All messages that nobody has taken yet."""
        messages, self._early = [*self._early, *self._inputs.waiting()], []
        return messages

    def wait(self, seconds: float) -> None:
        """Let time pass, and predict what comes meanwhile. Raises what a prediction raises; then there are no more."""
        end = time.monotonic() + seconds
        if self._publisher.get_subscription_count():
            self._say(self._stream.obstacle)
        while self._stream.ready and self._publisher.get_subscription_count() and time.monotonic() < end:
            time.sleep(_PERIOD)
            self._predict()
        time.sleep(max(0.0, end - time.monotonic()))

    def _predict(self) -> None:
        messages = self._inputs.waiting()
        self._early += messages
        try:
            for predicted in self._stream.predict([m.data for m in messages if m.topic == JOINT_STATES]):
                for data in serialised(predicted):
                    self._publisher.publish(data)
        except Exception:
            self.forget()
            raise
        for reason in tuple(self._stream.refused):
            self._say(reason)

    def _say(self, reason: str) -> None:
        """Why something is not streamed, once."""
        if reason and reason not in self._said:
            self._said.add(reason)
            self._warn(f"{self._publisher.topic_name} lacks messages: {reason}")


@cache
def _template(joints: tuple[str, ...]) -> AnyArray:
    """The bytes of a message of these joints, whose numbers are zero."""
    zeros = [0.0] * len(joints)
    data = serialize_message(JointState(name=joints, position=zeros, velocity=zeros, effort=zeros))
    return np.frombuffer(data, np.uint8)


def serialised(predicted: Predicted) -> Iterator[bytes]:
    """The messages (CDR). To make and to serialise them one by one takes several times as long."""
    count, size = predicted.efforts.shape
    data = np.tile(_template(predicted.joints), (count, 1))
    stamps = np.stack(np.divmod(predicted.stamps, 10**9), axis=1)
    data[:, 4:12] = stamps.astype("<u4", order="C").view(np.uint8)
    end = data.shape[1]
    for numbers in (predicted.efforts, predicted.motion[1], predicted.motion[0]):
        data[:, end - 8 * size : end] = numbers.astype("<f8", order="C").view(np.uint8)
        end -= 8 * size + 8  # the array's length stands before it, and is aligned
    return (row.tobytes() for row in data)
