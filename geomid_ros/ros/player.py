"""Publishes a bag's topics live, at the pace of the recording."""

from __future__ import annotations

import importlib
import signal
import time
from collections.abc import Callable, Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from geomid_ros.errors import InputError
from geomid_ros.files.bags import Bag

_LATCHED = ("robot_description", "tf_static")
_SETTLING = 0.5  # [s] a subscriber that does not ask for lost messages hears a publisher a little after it is seen
_LINGER = 1.0  # [s] what was published last must reach its subscribers before the publishers go


def play(path: Path, rate: float, wait: float, skipped: Callable[[str], None]) -> Iterator[tuple[int, int]]:
    """Publish a bag at ``rate`` times its own pace, reporting (messages published, messages in all).

    Waits up to ``wait`` [s] for a subscriber on each topic that carries data, so that none misses the beginning. Topics
    of types that are not installed are left out, and ``skipped`` is told of each.
    """
    with Bag(path) as bag:
        kinds = {topic: _message_class(kind) for topic, kind in bag.topics.items()}
        for topic in [topic for topic, kind in kinds.items() if kind is None]:
            skipped(f"{topic} is left out: its type {bag.topics[topic]} is not installed here")
            del kinds[topic]
        total = bag.count(list(kinds))
        # rclpy's own handlers would invalidate the publishers while they publish.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        node = rclpy.create_node("geomid_play")
        try:
            publishers = {topic: _publisher(node, topic, kind, path) for topic, kind in kinds.items()}
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


def _message_class(kind: str | None) -> Any:
    """The class of a message type, None if it is not installed."""
    package, _, name = (kind or "").partition("/msg/")
    if not package.isidentifier() or not _has_messages(package):
        return None
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name, None)
    except ImportError:
        return None


def _has_messages(package: str) -> bool:
    """Whether a package has messages. A bag may name any: merely to import it would be to run what it does then."""
    found = PathFinder.find_spec(package)
    folders = (found and found.submodule_search_locations) or []
    return any((Path(folder) / "msg" / "__init__.py").is_file() for folder in folders)


def _publisher(node: Node, topic: str, kind: Any, path: Path) -> Publisher:
    latched = topic.rpartition("/")[2] in _LATCHED
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    try:
        return node.create_publisher(kind, topic, QoSProfile(depth=1 if latched else 1000, durability=durability))
    except (NameValidationException, ValueError) as error:
        raise InputError(f"{path}: topic {topic!r} cannot be published ({' '.join(str(error).split())})") from error


def _wait_for_subscribers(publishers: dict[str, Publisher], wait: float) -> None:
    data = [publisher for topic, publisher in publishers.items() if topic.rpartition("/")[2] not in _LATCHED]
    deadline = time.monotonic() + wait
    while time.monotonic() < deadline and any(p.get_subscription_count() == 0 for p in data):
        time.sleep(0.02)
    time.sleep(_SETTLING)
