"""Recordings for tests: the shipped bags, and copies of them with something changed."""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from geomid_ros.signals.messages import JOINT_STATES, Message, Raw, parse

BAGS = Path(__file__).parents[2] / "bags"
TYPES = get_typestore(Stores.ROS2_JAZZY)
QUICK = 1e-3
"""The longest step of a simulation that is data for a test, which takes half the time of the usual one [s]."""


@dataclass(frozen=True)
class Recorded:
    """One message of a bag."""

    topic: str
    kind: str
    time: int
    message: Any

    @property
    def parsed(self) -> Message:
        """As a pipeline takes it."""
        return parse(JOINT_STATES if self.topic == "/joint_states" else self.topic, self.message)

    @property
    def raw(self) -> Raw:
        """As a worker takes it."""
        topic = JOINT_STATES if self.topic == "/joint_states" else self.topic
        return topic, bytes(TYPES.serialize_cdr(self.message, self.kind))

    def changed(self, **fields: Any) -> Recorded:
        """The same with other fields of the message."""
        return replace(self, message=replace(self.message, **fields))


def made(kind: str, **fields: Any) -> Any:
    """A message. Messages in it are given as dictionaries, or as lists of their numbers; what is not given is zero or
    empty."""
    return TYPES.types[kind](**{name: _field(*of, fields.get(name)) for name, of in TYPES.fielddefs[kind][1]})


def _field(node: Nodetype, of: Any, value: Any) -> Any:
    if node == Nodetype.NAME:
        named = value if isinstance(value, dict) else dict(zip(_names(of), value or (), strict=False))
        return made(of, **named)
    if value is not None:
        return value
    if node == Nodetype.BASE:
        return "" if of[0] == "string" else 0
    return np.zeros(of[1])


def _names(kind: str) -> list[str]:
    return [name for name, _ in TYPES.fielddefs[kind][1]]


def stamped(stamp: int, frame: str = "") -> dict[str, Any]:
    """A header, for :func:`made`."""
    return {"stamp": dict(zip(("sec", "nanosec"), divmod(stamp, 1_000_000_000), strict=True)), "frame_id": frame}


def recorded(bag: Path) -> list[Recorded]:
    """All messages of a bag in the order of recording."""
    return [*_shipped(bag)] if bag.parent == BAGS else _read(bag)


@cache
def _shipped(bag: Path) -> list[Recorded]:
    return _read(bag)


def _read(bag: Path) -> list[Recorded]:
    with Reader(bag) as reader:
        return [
            Recorded(c.topic, c.msgtype, time, TYPES.deserialize_cdr(raw, c.msgtype))
            for c, time, raw in reader.messages()
        ]


def write_bag(folder: Path, messages: Iterable[Recorded], storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Record messages into a new bag; returns ``folder``."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for item in messages:
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(item.topic, item.kind, typestore=TYPES)
            data = TYPES.serialize_cdr(item.message, item.kind)
            writer.write(connections[item.topic], item.time, bytes(data))
    return folder


def altered(bag: Path, folder: Path, change: Callable[[Recorded], Recorded | None]) -> Path:
    """A copy of a bag, each message as ``change`` makes it; what it makes None is left out."""
    return write_bag(folder, filter(None, map(change, recorded(bag))))


def chunks(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Of every chunk of an mcap file: where its CRC stands, and where its compressed data begin and end."""
    position = 8
    while data[position] != 0x02:
        (length,) = struct.unpack_from("<Q", data, position + 1)
        if data[position] == 0x06:
            (name,) = struct.unpack_from("<I", data, position + 9 + 28)
            yield position + 9 + 24, position + 9 + 40 + name, position + 9 + length
        position += 9 + length


def with_checksums(data: bytes, decompress: Callable[[bytes], bytes]) -> bytes:
    """An mcap file with the CRCs of its chunks, which rosbags leaves out when it writes."""
    result = bytearray(data)
    for crc, begin, end in chunks(data):
        struct.pack_into("<I", result, crc, crc32(decompress(data[begin:end])))
    return bytes(result)
