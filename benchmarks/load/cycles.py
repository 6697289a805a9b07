"""Start, stop, reset, another robot, over and over; and whole nodes: nothing may be left behind."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from geometry_msgs.msg import InertiaStamped
from ros.observer import Observer, latched
from ros.processes import PATIENCE, parameter_file
from ros.stage import staged
from std_msgs.msg import String

from benchmarks.load.holdings import holdings
from benchmarks.load.publisher import Stream
from benchmarks.load.robots import Robot
from benchmarks.load.watched import watched

_TICKS = 150
_RATE = 100.0  # [Hz] of the stamps: so many ticks give rows, however fast they are published
_EARLY = 0.1  # of the cycles: by then all is there that is made once

Holdings = tuple[float, int, int]


@dataclass(frozen=True)
class Cycles:
    """What was done ``count`` times, and what the process held early on and in the end: memory [MB], threads, file
    descriptors."""

    what: str
    count: int
    early: Holdings
    late: Holdings


def services(robot: Robot, count: int) -> Cycles:
    """In each cycle: stop, start, another description, reset; and messages for each robot."""
    silent = Robot(robot.name, "", robot.frames)  # its description comes on a topic
    held: list[Holdings] = []
    with TemporaryDirectory() as folder, watched(silent, {"solve_period": 0.05, "output_folder": folder}) as node:
        observer = node.stage.observer
        descriptions = observer.node.create_publisher(String, "robot_description", latched(1))
        stream = Stream(observer.node, robot, _RATE)
        descriptions.publish(String(data=_version(robot.urdf, 0)))
        observer.wait_for(lambda: stream.heard and node.values.get("active"), "the node")
        heard = observer.collect(InertiaStamped, "/geomid/inertias")
        origin = time.time_ns()
        for cycle in range(1, count + 1):
            _publish(stream, origin, cycle)
            for service in ("stop", "start"):
                _do(observer, service)
            descriptions.publish(String(data=_version(robot.urdf, cycle)))
            observer.spin(0.05)
            _do(observer, "reset")
            held.append(holdings(node.process.pid))
        if not heard:
            raise RuntimeError("the node never had an estimate")
    return Cycles("stop, start, description, reset", count, held[round(_EARLY * count)], held[-1])


def _publish(stream: Stream, origin: int, cycle: int) -> None:
    for tick in range(cycle * _TICKS, (cycle + 1) * _TICKS):
        stream.publish(tick, origin + round(tick * 1e9 / _RATE))
        time.sleep(0.0005)


def _do(observer: Observer, service: str) -> None:
    success, message = observer.trigger(f"/geomid/{service}")
    if not success:
        raise RuntimeError(f"~/{service}: {message}")


def _version(urdf: str, number: int) -> str:
    """One of two descriptions."""
    return urdf + "\n" * (number % 2)


def lives(robot: Robot, count: int) -> Cycles:
    """Whole nodes in one process."""
    with TemporaryDirectory() as name, staged(Path(name)) as stage:
        parameters = parameter_file(Path(name), robot.parameters)
        process = stage.start("benchmarks.load.lives", count, "--ros-args", "--params-file", parameters)
        stage.observer.wait_for(lambda: not process.running, "the end", PATIENCE + 5.0 * count)
        if process.status() != 0:
            raise RuntimeError(process.output)
        lines = [line.split() for line in process.output.splitlines() if not line.startswith("[")]
        held = [(float(memory), int(threads), int(files)) for memory, threads, files in lines]
    return Cycles("whole nodes in one process", count, held[round(_EARLY * count)], held[-1])
