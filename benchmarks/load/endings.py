"""Ctrl-C and SIGTERM in every state: how long the node takes to end, its status, and whether it saved what it knew."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geometry_msgs.msg import InertiaStamped
from ros.observer import latched
from ros.stage import staged
from std_srvs.srv import Trigger

from benchmarks.load.robots import Robot
from benchmarks.load.watched import Watched

_MESSAGES = 8.0  # [s] of them before a signal
_RATE = 1000.0  # Hz


@dataclass(frozen=True)
class Ending:
    """The node's ``state`` when it got a ``signal``; the seconds that it took to end, its exit status, and whether the
    last estimate that it published is in the file (None: it published none, and there is no file); what it ``said``
    last."""

    state: str
    signal: str
    seconds: float
    status: int
    saved: bool | None
    said: str


def _nothing(_: Watched) -> None:
    """It is in its state already."""


def _feed(node: Watched) -> None:
    """Messages come, and go on to come."""
    node.publish((60.0, _RATE))
    node.stage.observer.wait_for(lambda: node.account.accepted, "messages")
    node.stage.observer.spin(_MESSAGES)


def _call(service: str, wait: float) -> Callable[[Watched], None]:
    def begin(node: Watched) -> None:
        _feed(node)
        client = node.stage.observer.node.create_client(Trigger, f"/geomid/{service}")
        node.stage.observer.wait_for(client.service_is_ready, service)
        client.call_async(Trigger.Request())
        node.stage.observer.spin(wait)

    return begin


# By state: parameters, whether it knows its robot, and how it comes to be in it.
_STATES: dict[str, tuple[dict[str, Any], bool, Callable[[Watched], None]]] = {
    "before the description": ({}, False, _nothing),
    "idle": ({}, True, _nothing),
    "receiving, no estimate yet": ({"solve_period": 600.0}, True, _feed),
    "receiving": ({}, True, _feed),
    "solving without pause": ({"solve_period": 0.001}, True, _feed),
    "finding a gap": ({}, True, _call("find_gap", 1.0)),
    "saving": ({}, True, _call("save", 0.02)),
}


def endings(robot: Robot) -> Iterator[Ending]:
    """One node for each state and signal."""
    for state in _STATES:
        for number in (signal.SIGINT, signal.SIGTERM):
            yield _ended(robot, state, number)


def _ended(robot: Robot, state: str, number: signal.Signals) -> Ending:
    parameters, described, begin = _STATES[state]
    with TemporaryDirectory() as name, staged(Path(name)) as stage:
        out = Path(name) / "out"
        known = robot if described else Robot(robot.name, "", robot.frames)
        node = Watched(stage, known, {**parameters, "output_folder": str(out)})
        heard: list[InertiaStamped] = stage.observer.collect(InertiaStamped, "/geomid/inertias", latched())
        begin(node)
        sent = time.monotonic()
        node.process.send(number)
        status = node.process.status()
        seconds = time.monotonic() - sent
        stage.observer.spin(0.5)
        saved = _saved(heard, out / "estimate.json")
        return Ending(state, number.name, seconds, status, saved, node.process.output.strip().rpartition("\n")[2])


def _saved(heard: list[InertiaStamped], path: Path) -> bool | None:
    if not heard:
        return None if not path.exists() else False
    if not path.exists():
        return False
    links = json.loads(path.read_text(encoding="utf-8"))["links"]
    published = {message.header.frame_id: message.inertia.m for message in heard}  # the last of each link
    return {link["name"]: link["mass"] for link in links} == published
