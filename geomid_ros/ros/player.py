"""Publishes topics of a bag live, at the pace of the recording."""

from __future__ import annotations

import importlib
import signal
import time
from collections.abc import Callable, Collection, Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.bags.bag import Bag
from geomid_ros.ros.startup import MATCHING, running_node
from geomid_ros.signals.messages import IMU, JOINT_STATES, ODOM

_READ = (JOINT_STATES, ODOM, IMU, "robot_description", "/clock")  # read by geomid with any configuration
_LATCHED = ("robot_description", "tf_static")
_LINGER = 1.0  # [s] for the last messages to reach their subscribers before the publishers end


def play(
    path: Path, rate: float, wait: float, named: Collection[str], skipped: Callable[[str], None]
) -> Iterator[tuple[int, int]]:
    """Publish a bag live.

    Only topics that geomid always reads are published, and the ``named`` ones: other topics may have commands, which a
    robot that subscribes would follow. Topics of types that are not installed are left out.

    Args:
        path: of the bag.
        rate: times the pace of the recording.
        wait: [s] at most for a subscriber on each topic with data, so that none misses the beginning.
        named: further topics.
        skipped: receives a sentence on topics that are not published.

    Yields:
        The numbers of published messages, and of all.

    Raises:
        InputError: the bag has nothing to publish, or no topic of a name.
    """
    with Bag(path) as bag:
        for warning in bag.warnings:
            skipped(f"Warning: {warning}")
        chosen = _chosen(bag, named)
        if len(chosen) < len(bag.topics):
            others = ", ".join(topic for topic in bag.topics if topic not in chosen)
            skipped(f"Not published, as geomid does not read them (see --topic and --config): {others}")
        kinds = {topic: _message_class(bag.topics[topic]) for topic in chosen}
        for topic in [topic for topic, kind in kinds.items() if kind is None]:
            skipped(f"{topic} is left out: its type {bag.topics[topic]} is not installed here")
            del kinds[topic]
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        with running_node("geomid_play") as node:
            yield from _published(node, bag, kinds, rate, wait)


def _published(node: Node, bag: Bag, kinds: dict[str, Any], rate: float, wait: float) -> Iterator[tuple[int, int]]:
    publishers = {topic: _publisher(node, topic, kind, bag.path) for topic, kind in kinds.items()}
    _wait_for_subscribers(publishers, wait)
    total = bag.count(list(kinds))
    begin = time.monotonic()
    for published, (topic, stamp, _, raw) in enumerate(bag.raw_messages(list(kinds)), start=1):
        due = begin + (stamp - bag.start) * 1e-9 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        publishers[topic].publish(raw)
        yield published, total
    time.sleep(_LINGER)


def _chosen(bag: Bag, named: Collection[str]) -> list[str]:
    """Return the topics that are to be published."""
    for name in named:
        if not any(_is_called(topic, name) for topic in bag.topics):
            raise unknown_name(f"topic in {bag.path}", name, bag.topics)
    chosen = [topic for topic in bag.topics if any(_is_called(topic, name) for name in (*_READ, *named))]
    if not chosen:
        topics = ", ".join(bag.topics) or "none"
        raise InputError(f"{bag.path}: has no topic that geomid reads; name others with --topic. Its topics: {topics}")
    return chosen


def _is_called(topic: str, name: str) -> bool:
    """True if a topic has this name; a name without a leading slash matches any namespace."""
    return ("/" + topic.lstrip("/")).endswith("/" + name) if name[:1] != "/" else topic == name


def _message_class(kind: str | None) -> Any:
    """Return the class of a message type; None if it is not installed."""
    package, _, name = (kind or "").partition("/msg/")
    if not package.isidentifier() or not _has_messages(package):
        return None
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name, None)
    except ImportError:
        return None


def _has_messages(package: str) -> bool:
    """True if a package has messages, without importing it: a bag may name any package, and importing runs code."""
    spec = PathFinder.find_spec(package)
    folders = (spec and spec.submodule_search_locations) or []
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
    time.sleep(MATCHING)
