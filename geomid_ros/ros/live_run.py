"""Runs a node and a player as processes, and receives the node's results, for the demonstration."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
from rclpy.client import Client
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import try_shutdown
from std_srvs.srv import Trigger

from geomid_ros.errors import GeomidError
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.saving import FOLLOWS, NOT_YET, SLOW
from geomid_ros.ros.startup import starting_ros
from geomid_ros.session.configuration import Configuration

_PATIENCE = 60.0  # [s] for a service, and for its answer
_AFTERWARDS = 1.2  # [s] for the estimates of the save, and the diagnostics after it, to arrive


class LiveRun:
    """Runs ``geomid_node`` and ``geomid play`` on a bag, in a separate ROS domain."""

    def __init__(self, bag: Path, urdf: Path, configuration: Configuration, out: Path, rate: float) -> None:
        # A domain that robots on this network are unlikely to use; child processes inherit it.
        os.environ["ROS_DOMAIN_ID"] = str(102 + os.getpid() % 120)
        self._folder = tempfile.TemporaryDirectory(prefix="geomid-")
        parameters = Path(self._folder.name) / "parameters.yaml"
        values = {**configuration.given_values, "robot_description": read_urdf(urdf), "output_folder": str(out)}
        parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
        node = [sys.executable, "-m", "geomid_ros.ros.main", "--ros-args", "--params-file", str(parameters)]
        playing = ["play", str(bag), "--rate", str(rate), "--config", str(parameters)]
        self._log = (Path(self._folder.name) / "log").open("w+b")
        with starting_ros():
            rclpy.init()
            self._watcher = rclpy.create_node("geomid_demo")
        self._node = self._start(node)
        self._player = self._start([sys.executable, "-m", "geomid_ros", *playing])
        self._masses: dict[str, float] = {}
        self.diagnostics: dict[str, str] = {}  # latest values of the stream
        latched = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._watcher.create_subscription(InertiaStamped, "geomid/inertias", self._on_inertia, latched)
        self._watcher.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _start(self, command: list[str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, stdout=self._log, stderr=self._log)  # noqa: S603 the command is fixed

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
        client = self._watcher.create_client(Trigger, "geomid/save")
        if not client.wait_for_service(timeout_sec=_PATIENCE):
            raise GeomidError("the node does not offer the service ~/save")
        end = time.monotonic() + _PATIENCE
        result = self._ask(client)
        while result is not None and _is_late(result.message) and time.monotonic() < end:
            result = self._ask(client)
        if result is None or not result.success:
            raise GeomidError(f"the node could not save: {result.message if result else 'no answer'}")
        end = time.monotonic() + _AFTERWARDS
        while time.monotonic() < end:
            rclpy.spin_once(self._watcher, timeout_sec=0.05)

    def _ask(self, client: Client) -> Trigger.Response | None:
        answer = client.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(self._watcher, answer, timeout_sec=_PATIENCE)
        return answer.result()


def _is_late(answer: str) -> bool:
    """True if another save may succeed, or be from more data, as on a busy machine."""
    return any(word in answer for word in (FOLLOWS, NOT_YET, SLOW))
