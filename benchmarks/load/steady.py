"""A steady stream: everything must be taken, soon, and in a memory that does not grow."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import JointState

from benchmarks.load.robots import Robot
from benchmarks.load.watched import QUANTILES, Account, sent_by, watched

_FULL = 150.0  # [s] after which all that the node remembers for a while is there: gap.memory and a little


@dataclass(frozen=True)
class Steady:
    """Messages ``sent`` in ``seconds`` and what became of them; ``latency`` [ms] from receipt to row, ``longest_queue``
    and ``solves``; resident ``memory`` [MB] at the start, when the buffer was full, and in the end; shares of one core
    that node and solving process took, and the node alone; the ``latest`` [ms] that the publisher was behind.
    ``streamed``: ages [ms] of predictions when they arrive, empty if nobody subscribed."""

    robot: str
    seconds: float
    sent: int
    account: Account
    latency: dict[str, float]
    longest_queue: int
    solves: int
    memory: tuple[float, float, float]
    processor: float
    node_processor: float
    latest: float
    streamed: tuple[float, ...] = ()

    @property
    def unaccounted(self) -> int:
        """Messages that are in no account."""
        return self.sent - self.account.received - self.account.lost

    @property
    def microseconds(self) -> float:
        """Processor time of the node alone for a message."""
        return 1e6 * self.node_processor * self.seconds / max(self.account.received, 1)


def steady(robot: Robot, parameters: dict[str, Any], seconds: float, rate: float, *, streamed: bool = False) -> Steady:
    """Let a node take a robot's messages, ``rate`` [Hz] of each topic, for some time; predict each if ``streamed``."""
    with watched(robot, parameters) as node:
        ages: list[float] = []
        if streamed:
            node.stage.observer.node.create_subscription(
                JointState, "geomid/streamed_joint_states", lambda message: ages.append(_age(message)), 10_000, raw=True
            )
        start, processor, own = node.memory, node.processor, node.own_processor
        publisher = node.publish((seconds, rate))
        full, begin = 0.0, None
        while publisher.running:
            node.stage.observer.spin(1.0)
            begin = begin or (node.told[-1][0] if node.account.received else None)
            if begin and not full and node.told[-1][0] - begin >= min(_FULL, 0.5 * seconds):
                full = node.memory
        (sent,) = sent_by(publisher)
        processor = (node.processor - processor) / (sent.end - sent.begin)
        own = (node.own_processor - own) / (sent.end - sent.begin)
        node.settle()
        during = [values for when, values in node.told if when > sent.begin + 0.1 * seconds]
        return Steady(
            robot.name,
            sent.end - sent.begin,
            sent.ticks * len(robot.kinds),
            node.account,
            {q: max(float(values.get(f"receipt to row {q} [ms]", "nan")) for values in during) for q in QUANTILES},
            max(int(values["queue"]) for values in during),
            int(node.values["solves"]),
            (start, full, node.memory),
            processor,
            own,
            1e3 * sent.late,
            tuple(ages),
        )


def _age(message: bytes) -> float:
    """Time [ms] since the stamp of a serialised message: to deserialise it takes longer than to predict it."""
    seconds, nanoseconds = struct.unpack_from("<II", message, 4)
    return 1e3 * (time.time() - seconds - 1e-9 * nanoseconds)
