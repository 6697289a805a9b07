"""A day of data in less time: stamps run as fast as the node can follow, and its memory must not grow.

The real node, over DDS. The stamps are so far apart as the filter just allows, and the next messages are published when
the node's predictions show that it has taken those before: nothing is lost, and no clock is waited for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from benchmarks.load.publisher import Stream
from benchmarks.load.robots import Robot
from benchmarks.load.watched import Account, Watched, watched

_PERIOD = 80_000_000  # [ns] of the stamps: the longest for a cutoff of 5 Hz
_MOTION = 80.0  # [s] after which the motion is the same again
_AHEAD = 200  # ticks that are published before the predictions of the first of them
_PATIENCE = 60.0  # [s] for a prediction
_A_WHILE = 2.0  # [s]
_SLOWLY = 0.005  # [s] between ticks before the first estimate
_HOUR = 3600.0


@dataclass(frozen=True)
class Day:
    """``hours`` of stamps that took ``seconds``; messages ``sent`` and what became of them; resident ``memory`` [MB] by
    hour of the stamps, that at the start first; and ``solves``."""

    hours: float
    seconds: float
    sent: int
    account: Account
    memory: list[float]
    solves: int

    @property
    def unaccounted(self) -> int:
        """Messages that are in no account."""
        return self.sent - self.account.received - self.account.lost

    @property
    def growth(self) -> float:
        """From the end of the first hour on [MB]."""
        return self.memory[-1] - self.memory[1]


class _Follower:
    """Publishes as fast as a node predicts."""

    def __init__(self, node: Watched) -> None:
        self._node = node
        self._observer = node.stage.observer
        self._heard = time.monotonic()
        self._predicted = -1  # tick
        self._origin = time.time_ns()
        self.ticks = 0
        qos = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._observer.node.create_subscription(JointState, "geomid/predicted_joint_states", self._hear, qos)
        self._stream = Stream(self._observer.node, node.robot, 1e9 / _PERIOD, _MOTION)
        self._observer.wait_for(lambda: self._stream.heard, "the node")
        self._observer.spin(1.0)

    def _hear(self, message: JointState) -> None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        self._heard = time.monotonic()
        self._predicted = (stamp - self._origin) // _PERIOD

    def _wait(self) -> None:
        """Until the node has caught up; or for a while, as the predictions that are missing may be of lost messages."""
        begin = time.monotonic()
        while self.ticks - self._predicted > _AHEAD // 2 and time.monotonic() - begin < _A_WHILE:
            self._observer.spin(0.001)
        if time.monotonic() - self._heard > _PATIENCE:
            raise RuntimeError(f"no prediction for {_PATIENCE:g} s; the diagnostics are {self._node.values}")

    def follow(self, ticks: int) -> None:
        """Publish so many ticks in all."""
        while self.ticks < ticks:
            if self._predicted < 0:
                self._observer.spin(_SLOWLY)
            elif self.ticks - self._predicted > _AHEAD:
                self._wait()
            self._stream.publish(self.ticks, self._origin + self.ticks * _PERIOD)
            self.ticks += 1


def day(robot: Robot, hours: float, on_hour: Callable[[int, float], None]) -> Day:
    """Let a node have so many hours of data; ``on_hour`` is told of each, and of the memory then [MB]."""
    with watched(robot, {"solve_period": 0.001}) as node:
        memory = [node.memory]
        follower = _Follower(node)
        begin = time.monotonic()
        for hour in range(1, round(hours) + 1):
            follower.follow(round(hour * _HOUR * 1e9 / _PERIOD))
            memory.append(node.memory)
            on_hour(hour, memory[-1])
        seconds = time.monotonic() - begin
        node.settle()
        sent = follower.ticks * len(robot.kinds)
        return Day(hours, seconds, sent, node.account, memory, int(node.values["solves"]))
