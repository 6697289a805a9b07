"""Reading rosbags with the built-in message definitions only: type definitions in a bag are never executed.

Truncated files are read as far as they are intact, and :attr:`Bag.warnings` reports them.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, Self

from geomid_ros.errors import InputError, refusing
from geomid_ros.files.bags.database import Database
from geomid_ros.files.bags.mcap import McapFile
from geomid_ros.files.bags.storage import METHODS, RawMessage, Storage, decompress_file, decompress_message
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.signals.messages import message_types

_FORMATS: dict[str, Callable[[Path], Storage]] = {".mcap": McapFile, ".db3": Database}
_SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}  # by rosbag2's storage identifier
_ROS1 = ".bag"
_MAGIC = {b"\x89MCAP": ".mcap", b"SQLite format": ".db3", b"#ROSBAG": _ROS1}  # first bytes, by the suffix
_TO_JAZZY = ("--dst-typestore", "ros2_jazzy")
_METADATA = "metadata.yaml"
_MOST_MESSAGES = 4096  # per batch: streams wait for each other, so a batch must not exceed the messages kept meanwhile
_MOST_BYTES = 8_000_000  # per batch, and per message whose fields are read; a robot description has up to 5 MB


class Bag:
    """An open rosbag2 folder, or a single ``.mcap`` or ``.db3`` file, for a ``with`` statement.

    The whole recording is checked when it is opened. Raises InputError naming the file if it cannot be read; for a
    damaged file it states where the damage is and how much can be read.

    ``warnings`` are sentences on missing parts of the recording; ``has_checksums`` is True if all of it has checksums.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._storages: list[Storage] = []
        with ExitStack() as stack:
            with refusing(f"{path}: cannot be read as a rosbag2 recording", OSError):
                files = _bag_files(path, stack)
            for file in files.paths:
                with refusing(f"{file}: cannot be read as a rosbag2 recording", OSError):
                    self._storages.append(_FORMATS[files.suffix](file))
                stack.callback(self._storages[-1].close)
            self._packed = files.packed
            self._storages.sort(key=lambda storage: storage.start or 0)  # by time, as they may be listed in any order
            cut = [storage.truncation for storage in self._storages if storage.truncation]
            if cut and not any(count for storage in self._storages for count in storage.counts.values()):
                raise InputError(f"{'; '.join(cut)}. It cannot be read as a rosbag2 recording")
            self.warnings = (*files.warnings, *cut)
            self.has_checksums = all(storage.has_checksums for storage in self._storages)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def topics(self) -> dict[str, str | None]:
        """Message type of each topic; None for a topic with several types."""
        pairs = dict.fromkeys(topic_and_kind for storage in self._storages for topic_and_kind in storage.counts)
        kinds = Counter(topic for topic, _ in pairs)
        return {topic: kind if kinds[topic] == 1 else None for topic, kind in pairs}

    @property
    def start(self) -> int:
        """Recording time of the first message [ns]; zero if there is none."""
        return min((storage.start for storage in self._storages if storage.start is not None), default=0)

    def find_topic(self, name: str, message_type: str, option: str, instead: Sequence[str] = ()) -> str:
        """Return the topic ``name``, with or without leading slash. Its type is ``message_type`` or of ``instead``.

        Raises InputError otherwise, in which ``option`` tells the user where the name can be changed.
        """
        wanted = "/" + name.lstrip("/")
        topics = {("/" + topic.lstrip("/")): (topic, kind) for topic, kind in self.topics.items()}
        if wanted not in topics:
            listing = ", ".join(f"{topic} ({kind})" for topic, kind in self.topics.items()) or "none"
            raise InputError(f"{self.path}: has no topic {wanted}; {option} names another. Its topics: {listing}")
        topic, kind = topics[wanted]
        if kind not in (read := (message_type, *instead)):
            raise InputError(
                f"{self.path}: topic {topic} is of type {kind}, which is not read; expected {' or '.join(read)}. "
                f"Convert it to one of these, or name another topic ({option})"
            )
        return topic

    def count(self, topics: Collection[str]) -> int:
        """Number of messages on the topics."""
        counts = (item for storage in self._storages for item in storage.counts.items())
        return sum(count for (topic, _), count in counts if topic in topics)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, recording time [ns] and message of everything on ``topics``, in the order of recording."""
        types = message_types()
        for count, (topic, time, kind, data) in enumerate(self.raw_messages(topics)):
            if kind not in types.types:
                raise InputError(f"{self._where(topic, time)} has the type {kind}, which is not a standard ROS 2 type")
            self._check_size(topic, time, data)
            try:
                yield topic, time, types.deserialize_cdr(data, kind)
            except Exception as error:  # malformed bytes make the code for this type raise any error
                reason = (str(error).splitlines() or [type(error).__name__])[0]
                raise self.not_valid(topic, time, kind, reason, count) from error

    def _where(self, topic: str, time: int) -> str:
        return f"{self.path}: message on {topic} at {time} ns"

    def _check_size(self, topic: str, time: int, data: bytes) -> None:
        if len(data) > _MOST_BYTES:
            raise InputError(
                f"{self._where(topic, time)} has {len(data)} bytes, more than the maximum of {_MOST_BYTES}"
            )

    def not_valid(self, topic: str, time: int, kind: str, reason: str, count: int) -> InputError:
        """Make the error for a message whose bytes do not match its type, after ``count`` others."""
        return InputError(f"{self._where(topic, time)} is not a valid {kind} ({reason}); {count} before it are")

    def batches(self, topics: Collection[str]) -> Iterator[list[RawMessage]]:
        """Yield everything on ``topics``, many messages at once.

        Raises:
            InputError: a message is too large.
        """
        batch: list[RawMessage] = []
        size = 0
        for message in self.raw_messages(topics):
            self._check_size(message.topic, message.time, message.data)
            batch.append(message)
            size += sys.getsizeof(message.data)
            if len(batch) >= _MOST_MESSAGES or size > _MOST_BYTES:
                yield batch
                batch, size = [], 0
        if batch:
            yield batch

    def raw_messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield everything on ``topics`` as it was serialised, in the order of recording."""
        for storage in self._storages:
            for message in storage.messages(topics):
                yield self._unpacked(message, self._packed) if self._packed else message

    def _unpacked(self, message: RawMessage, method: str) -> RawMessage:
        with refusing(f"{self._where(message.topic, message.time)} cannot be unpacked", ValueError):
            return message._replace(data=decompress_message(message.data, method))


def bags_in(path: Path) -> list[Path]:
    """Readable recordings in a folder that is not itself one, sorted by name; otherwise the path alone.

    Raises InputError if the path cannot be accessed.
    """
    with refusing(f"{path}: cannot be read as a rosbag2 recording", OSError):
        if not path.is_dir() or _is_bag(path):
            return [path]
        inside = [inner for inner in path.iterdir() if os.access(inner, os.R_OK | os.X_OK) and inner.is_dir()]
        return sorted(inner for inner in inside if _is_bag(inner)) or [path]


def _is_bag(folder: Path) -> bool:
    return (folder / _METADATA).is_file() or bool(_files_in(folder))


def _files_in(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in _SUFFIXES.values())


@dataclass(frozen=True)
class _BagFiles:
    """Files of a recording, their ``suffix``, the per-message compression method, and sentences on missing parts."""

    paths: tuple[Path, ...]
    suffix: str
    packed: str = ""
    warnings: tuple[str, ...] = ()


def _bag_files(path: Path, stack: ExitStack) -> _BagFiles:
    """Find the files of a recording. Files compressed as a whole are unpacked into a folder that the ``stack`` removes.

    Raises InputError naming the file.
    """
    if not path.exists():
        raise InputError(f"{path}: no such bag")
    if path.is_dir():
        return _in_folder(path, stack)
    suffix = _type_of(_checked(path))
    if suffix == _ROS1:
        command = ["rosbags-convert", "--src", str(path), "--dst", str(path.with_suffix("")), *_TO_JAZZY]
        raise InputError(f"{path}: a bag of ROS 1; convert it with: {shlex.join(command)}")
    if suffix not in _SUFFIXES.values():
        expected = f"expected a bag's folder, or a file that ends in {' or '.join(_SUFFIXES.values())}"
        raise InputError(f"{path}: cannot be read as a rosbag2 recording, it has the wrong type; {expected}")
    return _BagFiles((path,), suffix)


def _type_of(path: Path) -> str:
    """Suffix that a file should have by its first bytes, whatever its name is; its own suffix if they are none."""
    with path.open("rb") as file:
        first = file.read(max(map(len, _MAGIC)))
    return next((suffix for magic, suffix in _MAGIC.items() if first.startswith(magic)), path.suffix)


def _in_folder(path: Path, stack: ExitStack) -> _BagFiles:
    metadata = path / _METADATA
    if not metadata.is_file():
        return _without_metadata(path)
    try:
        information = read_yaml(metadata, "bag's description")["rosbag2_bagfile_information"]
        paths = [_checked(path / PurePath(name).name) for name in information["relative_file_paths"]]
        suffix = _SUFFIXES[information["storage_identifier"]]
        mode, method = (information.get("compression_mode") or "none").lower(), information.get("compression_format")
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"no valid {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{metadata}: cannot be read, {problem}; 'ros2 bag reindex' rewrites it") from error
    if mode != "none" and (mode not in ("file", "message") or method not in METHODS):
        raise InputError(
            f"{metadata}: cannot be read, compression of a {mode} by {method}; expected file or message, "
            f"{' or '.join(METHODS)}"
        )
    if mode == "file":
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="geomid_bag_")))
        for index, file in enumerate(paths):
            paths[index] = folder / f"{index}-{file.stem}"
            with refusing(f"{file}: cannot be read as a rosbag2 recording", OSError, ValueError):
                decompress_file(file, paths[index], method)
    return _BagFiles(tuple(paths), suffix, packed=method if mode == "message" else "")


def _without_metadata(path: Path) -> _BagFiles:
    """Files of a folder without metadata, as a recorder leaves it that is killed."""
    files = _files_in(path)
    if len({file.suffix for file in files}) == 1:
        names = ", ".join(file.name for file in files)
        warning = f"{path}: has no {_METADATA} (was its recorder killed?); reading its files: {names}"
        return _BagFiles(tuple(map(_checked, files)), files[0].suffix, warnings=(warning,))
    inside = [bag for bag in bags_in(path) if bag != path]
    hint = f"name one of its bags ({inside[0]})" if inside else "name a bag's folder, or one of its files"
    raise InputError(f"{path}: a folder without {_METADATA} is not a rosbag; {hint}")


def _checked(path: Path) -> Path:
    """Return the path of a regular file; opening a pipe would block forever."""
    if not path.is_file():
        raise InputError(f"{path}: cannot be read as a part of a rosbag2 recording, the file is missing")
    return path
