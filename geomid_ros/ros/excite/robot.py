"""A robot as it is heard: its joints, its description, and the bag that is recorded of it, whole however that ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Self, TypeVar

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import WriterError
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import String

from geomid_ros.errors import GeomidError
from geomid_ros.excitation.watch import JointState
from geomid_ros.live.inbox import MOST_AT_ONCE
from geomid_ros.ros.outputs import latched
from geomid_ros.signals.messages import JOINT_STATES, parse
from geomid_ros.simulation.bag import BagWriter

_LOOK = 0.003  # [s] at most that a look waits for a message
_DESCRIPTION = "robot_description"
_WRENCH, _STATE, _TEXT = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
T = TypeVar("T")


class Recorder:
    """Writes serialised messages into a new bag, for a ``with`` statement.

    In a thread of its own: whoever watches over a robot does not wait for a disk.
    """

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        """
        Args:
            path: of the bag, which does not exist yet.
            topics: the messages' types, as ``sensor_msgs/msg/JointState``, by topic.

        Raises:
            GeomidError: the bag cannot be written.
        """
        self.path = path
        self.problem = ""
        """Why nothing is recorded any more, if so."""
        try:
            self._bag = BagWriter(path)
        except (OSError, WriterError) as error:
            raise GeomidError(f"{path}: cannot be written ({error})") from error
        self._topics = {topic: self._bag.topic(topic, kind) for topic, kind in topics.items()}
        self._waiting: SimpleQueue[tuple[str, int, bytes] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.put(None)
        self._thread.join()

    def write(self, topic: str, data: bytes) -> None:
        """Record a message as received now."""
        self._waiting.put((topic, time.time_ns(), data))

    def _work(self) -> None:
        try:
            while (message := self._waiting.get()) is not None:
                topic, stamp, data = message
                self._bag.write(self._topics[topic], stamp, data)
            self._bag.close()
        except OSError as error:
            self.problem = f"{self.path}: cannot be written ({error.strerror or error})"


class HeardRobot:
    """Subscribes to joint states and description, and records what is heard when it is asked to."""

    def __init__(self, node: Node, joints: tuple[str, ...], topic: str, interrupted: Callable[[], bool]) -> None:
        """
        Args:
            node: subscribes.
            joints: whose states are asked for.
            topic: of the joint states.
            interrupted: whether the user wants an end.
        """
        self._joints = joints
        self._interrupted = interrupted
        self._node = node
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._new: list[JointState] = []
        self._recorder: Recorder | None = None
        self.description = ""
        """The robot's URDF, as it was heard."""
        self.positions: dict[str, float] = {}
        """Of all joints that were heard of, by name; not finite where they are not known."""
        self.state: JointState | None = None
        """The last one."""
        self._qos = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._states = node.create_subscription(JointStateMessage, topic, self._take, self._qos, raw=True)
        self._descriptions = node.create_subscription(String, _DESCRIPTION, self._describe, latched())
        self.topic: str = self._states.topic_name
        """Of the joint states, in full."""

    def look(self) -> list[JointState]:
        """What has come since the last look, or comes within a moment."""
        self._executor.spin_once(timeout_sec=_LOOK)
        for _ in range(MOST_AT_ONCE):
            with self._states.handle:
                taken = self._states.handle.take_message(JointStateMessage, True)
            if taken is None:
                break
            self._take(taken[0])
        new, self._new = self._new, []
        return new

    def wait_for(self, find: Callable[[], T | None], patience: float) -> T | None:
        """What is found within ``patience`` [s]. Raises GeomidError when the user wants an end."""
        end = time.monotonic() + patience
        while (found := find()) is None and time.monotonic() < end:
            if self._interrupted():
                raise GeomidError("interrupted; nothing has moved")
            self.look()
        return found

    def period(self, seconds: float) -> float:
        """The time from one joint state to the next [s], by what comes within some ``seconds``."""
        begin, count = time.monotonic(), 0
        while time.monotonic() - begin < seconds:
            count += len(self.look())
        return (time.monotonic() - begin) / max(count, 1)

    @contextmanager
    def recorded(self, path: Path, urdf: str) -> Iterator[Recorder]:
        """Record joint states and all wrenches that there are into a new bag, and the ``urdf`` as description."""
        known = self._node.get_topic_names_and_types()
        wrenches = {topic: _WRENCH for topic, kinds in known if kinds == [_WRENCH]}
        description: str = self._descriptions.topic_name
        with Recorder(path, {self.topic: _STATE, description: _TEXT, **wrenches}) as recorder:
            recorder.write(description, serialize_message(String(data=urdf)))
            for topic in wrenches:
                write = partial(recorder.write, topic)
                self._node.create_subscription(WrenchStamped, topic, write, self._qos, raw=True)
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
        known = position if len(position) == count else np.full(count, np.nan)
        self.positions.update(zip(message.names, known.tolist(), strict=True))
        if (state := JointState.of(message, self._joints)) is not None:
            self.state = state
            self._new.append(state)

    def _describe(self, message: String) -> None:
        self.description = message.data
