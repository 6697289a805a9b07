"""Plays a bag live at the pace of the recording, and in the demonstration to a node whose results it receives."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, Self

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.utilities import try_shutdown
from std_srvs.srv import Trigger

from geomid_ros.errors import GeomidError, InputError, unknown_name
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.saving import FOLLOWS, NOT_YET, SLOW
from geomid_ros.ros.outputs import latched
from geomid_ros.ros.startup import MATCHING, running_node, starting_ros
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.messages import IMU, JOINT_STATES, ODOM

_READ = (JOINT_STATES, ODOM, IMU, "robot_description", "/clock")  # read by geomid with any configuration
_LATCHED = ("robot_description", "tf_static")
_LINGER = 1.2  # [s] for the last messages, and diagnostics of them, to reach their subscribers


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
            publishers = {topic: _publisher(node, topic, kind, path) for topic, kind in kinds.items()}
            _wait_for_subscribers(publishers, wait)
            total, begin = bag.count(list(kinds)), time.monotonic()
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
    # A bag may name any package, and importing runs code: only packages of messages are imported.
    spec = PathFinder.find_spec(package) if package.isidentifier() else None
    folders = (spec and spec.submodule_search_locations) or []
    if not any((Path(folder) / "msg" / "__init__.py").is_file() for folder in folders):
        return None
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name, None)
    except ImportError:
        return None


def _publisher(node: Node, topic: str, kind: Any, path: Path) -> Publisher:
    try:
        return node.create_publisher(kind, topic, latched() if topic.rpartition("/")[2] in _LATCHED else 1000)
    except (NameValidationException, ValueError) as error:
        raise InputError(f"{path}: topic {topic!r} cannot be published ({' '.join(str(error).split())})") from error


def _wait_for_subscribers(publishers: dict[str, Publisher], wait: float) -> None:
    data = [publisher for topic, publisher in publishers.items() if topic.rpartition("/")[2] not in _LATCHED]
    deadline = time.monotonic() + wait
    while time.monotonic() < deadline and any(p.get_subscription_count() == 0 for p in data):
        time.sleep(0.02)
    time.sleep(MATCHING)


_PATIENCE = 60.0  # [s] for a service, and for its answer


class LiveRun:
    """Runs ``geomid_node`` and ``geomid play`` on a bag, in a separate ROS domain."""

    def __init__(self, bag: Path, urdf: Path, configuration: Configuration, out: Path, rate: float) -> None:
        # A domain that robots on this network are unlikely to use; child processes inherit it.
        os.environ["ROS_DOMAIN_ID"] = str(102 + os.getpid() % 120)
        self._folder = tempfile.TemporaryDirectory(prefix="geomid-")
        parameters = Path(self._folder.name) / "parameters.yaml"
        values = {**configuration.given_values, "robot_description": read_urdf(urdf), "output_folder": str(out)}
        parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
        node = ["geomid_ros.ros.main", "--ros-args", "--params-file", str(parameters)]
        playing = ["geomid_ros", "play", str(bag), "--rate", str(rate), "--config", str(parameters)]
        self._log = (Path(self._folder.name) / "log").open("w+b")
        with starting_ros():
            rclpy.init()
            self._watcher = rclpy.create_node("geomid_demo")
        self._node, self._player = (
            subprocess.Popen([sys.executable, "-m", *module], stdout=self._log, stderr=self._log)  # noqa: S603 fixed
            for module in (node, playing)
        )
        self._masses: dict[str, float] = {}
        self.diagnostics: dict[str, str] = {}  # latest values of the stream
        self._watcher.create_subscription(InertiaStamped, "geomid/inertias", self._on_inertia, latched(256))
        self._watcher.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in (self._player, self._node):
            process.send_signal(signal.SIGINT)
        for process in (self._player, self._node):
            try:
                process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()
        self._watcher.destroy_node()
        try_shutdown()
        self._log.close()
        self._folder.cleanup()

    def _on_inertia(self, message: InertiaStamped) -> None:
        self._masses[message.header.frame_id] = message.inertia.m

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        stream = next(status for status in message.status if status.name.endswith(": stream"))
        self.diagnostics = {pair.key: pair.value for pair in stream.values}

    def watch(self) -> Iterator[dict[str, float]]:
        """Yield the links' masses [kg] several times a second, until the bag is played and the estimate saved."""
        while self._player.poll() is None:
            self._require(self._node, "the node")
            rclpy.spin_once(self._watcher, timeout_sec=0.1)
            yield self._masses
        self._require(self._player, "the player")
        self._save()
        yield self._masses

    def _require(self, process: subprocess.Popen[bytes], name: str) -> None:
        if process.poll() not in (None, 0):
            self._log.seek(0)
            raise GeomidError(f"{name} ended unexpectedly:\n{self._log.read().decode(errors='replace')}")

    def _save(self) -> None:
        """Save, again while another save may succeed or be from more data, as on a busy machine."""
        client = self._watcher.create_client(Trigger, "geomid/save")
        if not client.wait_for_service(timeout_sec=_PATIENCE):
            raise GeomidError("the node does not offer the service ~/save")
        end, is_late = time.monotonic() + _PATIENCE, True
        while is_late and time.monotonic() < end:
            answer = client.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(self._watcher, answer, timeout_sec=_PATIENCE)
            saved, sentence = (result.success, result.message) if (result := answer.result()) else (False, "no answer")
            is_late = any(part in sentence for part in (FOLLOWS, NOT_YET, SLOW))
        if not saved:
            raise GeomidError(f"the node could not save: {sentence}")
        end = time.monotonic() + _LINGER
        while time.monotonic() < end:
            rclpy.spin_once(self._watcher, timeout_sec=0.05)
