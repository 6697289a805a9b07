"""Data of a robot from its topics: joint states, description, and a bag that is complete even after an error."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import WriterError
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import String

from geomid_ros.errors import GeomidError
from geomid_ros.excitation.limits import JointState
from geomid_ros.live.inbox import MOST_AT_ONCE
from geomid_ros.ros.inputs import DATA
from geomid_ros.ros.outputs import latched
from geomid_ros.ros.startup import POLL
from geomid_ros.signals.messages import JOINT_STATES, parse
from geomid_ros.simulation.bag import BagWriter

_DESCRIPTION = "robot_description"
_WRENCH, _STATE, _TEXT = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
T = TypeVar("T")


class Recorder:
    """Writes serialised messages into a new bag; a context manager.

    It writes in a separate thread, as the monitoring of a robot must not wait for a disk.
    """

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        """
        Args:
            path: of the bag, which does not exist yet.
            topics: types of the messages, as ``sensor_msgs/msg/JointState``, by topic.

        Raises:
            GeomidError: the bag cannot be written.
        """
        self.path = path
        self.problem = ""
        """Reason why recording has stopped; empty if it has not."""
        try:
            self._bag = BagWriter(path)
        except (OSError, WriterError) as error:
            raise GeomidError(f"{path}: cannot be written ({error})") from error
        self._topics = {topic: self._bag.topic(topic, kind) for topic, kind in topics.items()}
        self._thread = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.submit(self._do, self._bag.close)
        self._thread.shutdown()

    def write(self, topic: str, data: bytes) -> None:
        """Record a message as received now."""
        self._thread.submit(self._do, self._bag.write, self._topics[topic], time.time_ns(), data)

    def _do(self, act: Callable[..., object], *arguments: Any) -> None:
        try:
            act(*arguments)
        except OSError as error:
            self.problem = f"{self.path}: cannot be written ({error.strerror or error})"


class RobotMonitor:
    """Subscribes to joint states and the description, and records messages on request."""

    def __init__(self, node: Node, joints: tuple[str, ...], topic: str, interrupted: Callable[[], bool]) -> None:
        """
        Args:
            node: subscribes.
            joints: whose states are requested.
            topic: of the joint states.
            interrupted: returns True if the user interrupts.
        """
        self._node, self._joints, self._interrupted = node, joints, interrupted
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._new: list[JointState] = []
        self._recorder: Recorder | None = None
        self.description = ""
        """URDF of the robot, as received."""
        self.positions: dict[str, float] = {}
        """Positions of all received joints by name; not finite if unknown."""
        self.state: JointState | None = None
        """Latest joint state."""
        self._states = node.create_subscription(JointStateMessage, topic, self._take, DATA, raw=True)
        self._descriptions = node.create_subscription(String, _DESCRIPTION, self._describe, latched())
        self.topic: str = self._states.topic_name
        """Full name of the joint states' topic."""

    def poll(self) -> list[JointState]:
        """Return the joint states since the last call, or within a moment."""
        self._executor.spin_once(timeout_sec=POLL)
        for _ in range(MOST_AT_ONCE):
            with self._states.handle:
                taken = self._states.handle.take_message(JointStateMessage, True)
            if taken is None:
                break
            self._take(taken[0])
        states, self._new = self._new, []
        return states

    def wait_for(self, find: Callable[[], T | None], patience: float) -> T | None:
        """Return the result of ``find``, None after ``patience`` [s]. Raises GeomidError if the user interrupts."""
        end = time.monotonic() + patience
        while (result := find()) is None and time.monotonic() < end:
            if self._interrupted():
                raise GeomidError("interrupted; nothing has moved")
            self.poll()
        return result

    def period(self, seconds: float) -> float:
        """Mean time between joint states [s], measured for some ``seconds``."""
        begin, count = time.monotonic(), 0
        while time.monotonic() - begin < seconds:
            count += len(self.poll())
        return (time.monotonic() - begin) / max(count, 1)

    @contextmanager
    def record(self, path: Path, urdf: str) -> Iterator[Recorder]:
        """Record joint states and all wrenches into a new bag, with the ``urdf`` as description."""
        topics = self._node.get_topic_names_and_types()
        wrenches = {topic: _WRENCH for topic, kinds in topics if kinds == [_WRENCH]}
        description: str = self._descriptions.topic_name
        with Recorder(path, {self.topic: _STATE, description: _TEXT, **wrenches}) as recorder:
            recorder.write(description, serialize_message(String(data=urdf)))
            for topic in wrenches:
                write = partial(recorder.write, topic)
                self._node.create_subscription(WrenchStamped, topic, write, DATA, raw=True)
            self._recorder = recorder
            try:
                yield recorder
            finally:
                self._recorder = None

    def _take(self, data: bytes) -> None:
        if self._recorder is not None:
            self._recorder.write(self.topic, data)
        message = parse(JOINT_STATES, deserialize_message(data, JointStateMessage))
        count, position = len(message.names), message.arrays[0]
        positions = position if len(position) == count else np.full(count, np.nan)
        self.positions.update(zip(message.names, positions.tolist(), strict=True))
        if (state := JointState.of(message, self._joints)) is not None:
            self.state = state
            self._new.append(state)

    def _describe(self, message: String) -> None:
        self.description = message.data
