"""Bags as a reader other than ours sees them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import ConnectionExtRosbag2, QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Recorded:
    """A bag's messages by topic, raw and read."""

    raw: list[tuple[str, int, bytes]]
    messages: dict[str, list[Any]]
    durability: dict[str, QosDurability]


def recorded(bag: Path) -> Recorded:
    """Everything in a bag."""
    with Reader(bag) as reader:
        raw = [(connection.topic, stamp, bytes(data)) for connection, stamp, data in reader.messages()]
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        durability = {
            connection.topic: connection.ext.offered_qos_profiles[0].durability
            for connection in reader.connections
            if isinstance(connection.ext, ConnectionExtRosbag2)
        }
    messages: dict[str, list[Any]] = {topic: [] for topic in kinds}
    for topic, _, data in raw:
        messages[topic].append(TYPES.deserialize_cdr(data, kinds[topic]))
    return Recorded(raw, messages, durability)
