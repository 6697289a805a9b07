"""A steady stream: everything must be taken, soon, and in a memory that does not grow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.load.robots import Robot
from benchmarks.load.watched import QUANTILES, Account, sent_by, watched

_RATE = 1000.0  # Hz
_FULL = 150.0  # [s] after which all that the node remembers for a while is there: gap.memory and a little


@dataclass(frozen=True)
class Steady:
    """Messages ``sent`` in ``seconds`` and what became of them; ``latency`` [ms] from receipt to row, ``longest_queue``
    and ``solves``; resident ``memory`` [MB] at the start, when the buffer was full, and in the end; share of one core
    that the node took; the ``latest`` [ms] that the publisher was behind."""

    robot: str
    seconds: float
    sent: int
    account: Account
    latency: dict[str, float]
    longest_queue: int
    solves: int
    memory: tuple[float, float, float]
    processor: float
    latest: float

    @property
    def unaccounted(self) -> int:
        """Messages that are in no account."""
        return self.sent - self.account.received - self.account.lost


def steady(robot: Robot, parameters: dict[str, Any], seconds: float) -> Steady:
    """Let a node take a robot's messages for some time."""
    with watched(robot, parameters) as node:
        start, processor = node.memory, node.processor
        publisher = node.publish((seconds, _RATE))
        full, begin = 0.0, None
        while publisher.running:
            node.stage.observer.spin(1.0)
            begin = begin or (node.told[-1][0] if node.account.received else None)
            if begin and not full and node.told[-1][0] - begin >= min(_FULL, 0.5 * seconds):
                full = node.memory
        (sent,) = sent_by(publisher)
        processor = (node.processor - processor) / (sent.end - sent.begin)
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
            1e3 * sent.late,
        )
