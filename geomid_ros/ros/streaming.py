"""Predicted efforts at the rate of the messages, while other messages wait to be taken in batches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter

import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from geomid_ros.live.effort_predictor import EffortPredictor, Predicted
from geomid_ros.live.inbox import Received
from geomid_ros.ros.inputs import Inputs
from geomid_ros.signals.messages import JOINT_STATES

_PERIOD = 5e-3  # [s] between polls for messages, each of which costs as much as a message


class Streaming:
    """Publishes ``~/streamed_joint_states`` while it has subscribers, and keeps the messages for the worker."""

    def __init__(self, node: Node, inputs: Inputs, predictor: EffortPredictor, warn: Callable[[str], None]) -> None:
        """
        Args:
            node: publishes.
            inputs: where messages wait.
            predictor: predicts them.
            warn: receives the reason why messages are not streamed.
        """
        self._inputs = inputs
        self._publisher = node.create_publisher(JointState, "~/streamed_joint_states", 1000)
        self._predictor = predictor
        self._early: list[Received] = []
        self._warn = warn
        self._warned: set[str] = set()

    def forget(self) -> None:
        """Predict nothing until the next estimate."""
        self._predictor.forget()
        self._warned.clear()

    def drain(self) -> list[Received]:
        """Return all messages that were not taken yet."""
        messages, self._early = [*self._early, *self._inputs.poll()], []
        return sorted(messages, key=attrgetter("time"))

    @property
    def active(self) -> bool:
        """True if there is a subscriber, and an estimate to predict with."""
        return self._predictor.ready and bool(self._publisher.get_subscription_count())

    def wait(self, seconds: float) -> None:
        """Wait, and predict messages meanwhile. An error is raised, and stops predictions until the next estimate."""
        end = time.monotonic() + seconds
        if self._publisher.get_subscription_count():
            self._say(self._predictor.obstacle)
        while self.active and time.monotonic() < end:
            time.sleep(_PERIOD)
            self._predict()
        time.sleep(max(0.0, end - time.monotonic()))

    def _predict(self) -> None:
        messages, handle = self._inputs.poll(JOINT_STATES), self._publisher.handle
        self._early += messages
        try:
            for predicted in self._predictor.predict([message.data for message in messages]):
                with handle:
                    for data in serialised(predicted):
                        handle.publish_raw(data)
        except Exception:
            self.forget()
            raise
        for reason in tuple(self._predictor.refused):
            self._say(reason)

    def _say(self, reason: str) -> None:
        """Warn once why messages are not streamed."""
        if reason and reason not in self._warned:
            self._warned.add(reason)
            self._warn(f"{self._publisher.topic_name} lacks messages: {reason}")


@cache
def _template(joints: tuple[str, ...]) -> tuple[bytes, np.dtype[np.void]]:
    """Return a message of these joints with zeros as numbers, and its layout."""
    zeros = [0.0] * len(joints)
    data = serialize_message(JointState(name=joints, position=zeros, velocity=zeros, effort=zeros))
    numbers, count = ("<f8", (len(joints),)), "V8"  # an array's length precedes it, and is aligned
    begin = f"V{len(data) - 12 - 3 * 8 * len(joints) - 2 * 8}"  # header and names
    stamp = [("", "V4"), ("seconds", "<u4"), ("nanoseconds", "<u4"), ("", begin)]
    return data, np.dtype(
        [*stamp, ("position", numbers), ("", count), ("velocity", numbers), ("", count), ("effort", numbers)]
    )


def serialised(predicted: Predicted) -> Iterator[bytes]:
    """Yield the messages (CDR). Making and serialising them one by one takes several times as long."""
    data, form = _template(predicted.joints)
    messages = np.frombuffer(bytearray(data * len(predicted.stamps)), form)
    messages["seconds"], messages["nanoseconds"] = np.divmod(predicted.stamps, 10**9)
    messages["position"], messages["velocity"] = predicted.motion[:2]
    messages["effort"] = predicted.efforts
    return (message.tobytes() for message in messages)
