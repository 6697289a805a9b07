"""Reading rosbags, with only the built-in message definitions: what a bag says of its types is never executed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from geomid_ros.errors import InputError

_typestore = get_typestore(Stores.ROS2_JAZZY)


class Bag:
    """An open rosbag2 folder, or a single ``.mcap`` or ``.db3`` file; use it in a ``with`` statement.

    Raises InputError, naming the file, for whatever cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.exists():
            raise InputError(f"{path}: no such bag")
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            inside = sorted(p.name for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
            hint = f"name the file itself ({path / inside[0]}) or" if inside else "record it again, or"
            raise InputError(
                f"{path}: a folder without metadata.yaml is no rosbag; {hint} run 'ros2 bag reindex' on it"
            )
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # damaged files make the reader's libraries raise errors of any kind
            raise InputError(f"{path}: cannot be read as a rosbag2 recording ({_first_line(error)})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()

    @property
    def topics(self) -> dict[str, str | None]:
        """Message type of each topic."""
        return {name: info.msgtype for name, info in self._reader.topics.items()}

    @property
    def start(self) -> int:
        """When the first message was recorded [ns]."""
        return self._reader.start_time

    def find_topic(self, name: str, message_type: str, option: str) -> str:
        """The topic called ``name``, with or without a leading slash, checked to carry ``message_type``.

        ``option`` tells the user where the name can be changed.
        """
        wanted = "/" + name.lstrip("/")
        topics = {("/" + topic.lstrip("/")): (topic, kind) for topic, kind in self.topics.items()}
        if wanted not in topics:
            listing = ", ".join(f"{topic} ({kind})" for topic, kind in self.topics.items()) or "none"
            raise InputError(f"{self.path}: has no topic {wanted}, which {option} names. Its topics: {listing}")
        topic, kind = topics[wanted]
        if kind != message_type:
            raise InputError(f"{self.path}: topic {topic} is of type {kind}, expected {message_type}")
        return topic

    def count(self, topics: Collection[str]) -> int:
        """How many messages the topics have."""
        return sum(self._reader.topics[topic].msgcount for topic in topics)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and message of everything on ``topics``, in the order of recording."""
        for topic, time, raw, kind in self._raw_messages(topics):
            try:
                yield topic, time, _typestore.deserialize_cdr(raw, kind)
            except Exception as error:
                raise InputError(
                    f"{self.path}: message on {topic} at {time} ns is not a valid {kind} ({_first_line(error)})"
                ) from error

    def raw_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording [ns] and serialised message of everything on ``topics``."""
        for topic, time, raw, _ in self._raw_messages(topics):
            yield topic, time, raw

    def _raw_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes, str]]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        read = 0
        try:
            for connection, time, raw in self._reader.messages(connections):
                read += 1
                yield connection.topic, time, bytes(raw), connection.msgtype
        except Exception as error:
            raise InputError(
                f"{self.path}: damaged or cut off after {read} messages ({_first_line(error)}); "
                "'ros2 bag reindex' or 'mcap recover' may save the rest"
            ) from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
