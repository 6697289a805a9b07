"""The process that solves is killed over and over, while the node takes messages."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass

from geometry_msgs.msg import InertiaStamped

from benchmarks.load.robots import Robot
from benchmarks.load.watched import Account, Watched, sent_by, watched
from benchmarks.measuring import family, proportional

_RATE = 1000.0  # Hz
_SPIN = 0.1  # s


@dataclass(frozen=True)
class Kills:
    """How often the process was killed in ``seconds``, messages ``sent`` and what became of them, and how long [s]
    after each kill the next estimate came; infinite if none did."""

    seconds: float
    kills: int
    sent: int
    account: Account
    pauses: list[float]

    @property
    def unaccounted(self) -> int:
        """Messages that are in no account."""
        return self.sent - self.account.received - self.account.lost


def kills(robot: Robot, seconds: float, count: int) -> Kills:
    """Let a node take a robot's messages for some time, and kill its solving process ``count`` times, evenly, each time
    after another estimate."""
    with watched(robot, {}) as node:
        estimates: list[float] = []
        node.stage.observer.node.create_subscription(
            InertiaStamped, "/geomid/inertias", lambda _: estimates.append(time.monotonic()), 1000
        )
        publisher = node.publish((seconds, _RATE))
        node.stage.observer.wait_for(lambda: estimates, "the first estimate")
        killed: list[float] = []
        begin = time.monotonic()
        while publisher.running:
            node.stage.observer.spin(_SPIN)
            due = begin + seconds * (len(killed) + 0.5) / (count + 1)
            goes_on = not killed or estimates[-1] > killed[-1]
            if len(killed) < count and time.monotonic() > due and goes_on and _kill_solving_process(node):
                killed.append(time.monotonic())
        (sent,) = sent_by(publisher)
        node.settle()
        pauses = [min((t - kill for t in estimates if t > kill), default=float("inf")) for kill in killed]
        return Kills(sent.end - sent.begin, len(killed), sent.ticks * len(robot.kinds), node.account, pauses)


def _kill_solving_process(node: Watched) -> bool:
    """Kill the node's largest child, the others being Python's own; whether it had one."""
    try:
        os.kill(max(family(node.process.pid)[1:], key=proportional), signal.SIGKILL)
    except (ProcessLookupError, ValueError):  # the one before is not replaced yet
        return False
    return True
