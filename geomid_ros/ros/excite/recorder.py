"""Records messages into a bag, which is whole however the recording ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Self

from rosbags.interfaces import Connection, QosDurability
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from geomid_ros.errors import GeomidError
from geomid_ros.simulation.bag import add_checksums, reliable

_TYPES = get_typestore(Stores.ROS2_JAZZY)
_LATCHED = "robot_description"


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
            self._writer = Writer(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, WriterError) as error:
            raise GeomidError(f"{path}: cannot be written ({error})") from error
        self._connections = {topic: self._connection(topic, kind) for topic, kind in topics.items()}
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

    def _connection(self, topic: str, kind: str) -> Connection:
        latched = topic.rpartition("/")[2] == _LATCHED
        durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        return self._writer.add_connection(topic, kind, typestore=_TYPES, offered_qos_profiles=[reliable(durability)])

    def _work(self) -> None:
        try:
            while (message := self._waiting.get()) is not None:
                topic, stamp, data = message
                self._writer.write(self._connections[topic], stamp, data)
            self._writer.close()
            add_checksums(self.path / f"{self.path.name}.mcap")
        except OSError as error:
            self.problem = f"{self.path}: cannot be written ({error.strerror or error})"
