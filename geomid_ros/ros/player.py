"""Publishes a bag's topics live, at the pace of the recording."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import try_shutdown

from geomid_ros.errors import InputError
from geomid_ros.files.bags import Bag

_LATCHED = ("robot_description", "tf_static")
_LINGER = 1.0  # [s] what was published last must reach its subscribers before the publishers go


def play(path: Path, rate: float, wait: float) -> Iterator[tuple[int, int]]:
    """Publish everything in a bag at ``rate`` times its own pace, reporting (messages published, messages in all).

    Waits up to ``wait`` [s] for a subscriber on each topic that carries data, so that none misses the beginning.
    """
    with Bag(path) as bag:
        kinds = {topic: _message_class(path, topic, kind) for topic, kind in bag.topics.items()}
        total = bag.count(list(kinds))
        rclpy.init()
        node = rclpy.create_node("geomid_play")
        try:
            publishers = {topic: _publisher(node, topic, kind) for topic, kind in kinds.items()}
            _wait_for_subscribers(publishers, wait)
            begin = time.monotonic()
            for published, (topic, stamp, raw) in enumerate(bag.raw_messages(list(kinds)), start=1):
                due = begin + (stamp - bag.start) * 1e-9 / rate
                time.sleep(max(0.0, due - time.monotonic()))
                publishers[topic].publish(raw)
                yield published, total
            time.sleep(_LINGER)
        finally:
            node.destroy_node()
            try_shutdown()


def _message_class(path: Path, topic: str, kind: str | None) -> Any:
    package, _, name = (kind or "").partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: topic {topic} is of type {kind}, which is not installed here") from error


def _publisher(node: Node, topic: str, kind: Any) -> Publisher:
    latched = topic.rpartition("/")[2] in _LATCHED
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(kind, topic, QoSProfile(depth=1 if latched else 1000, durability=durability))


def _wait_for_subscribers(publishers: dict[str, Publisher], wait: float) -> None:
    data = [publisher for topic, publisher in publishers.items() if topic.rpartition("/")[2] not in _LATCHED]
    deadline = time.monotonic() + wait
    while time.monotonic() < deadline and any(p.get_subscription_count() == 0 for p in data):
        time.sleep(0.02)
