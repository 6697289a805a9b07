"""A node under watch: what its diagnostics say, and what the system says of its process."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from ros.processes import Process
from ros.stage import Stage, staged

from benchmarks.load.publisher import Sent
from benchmarks.load.robots import Robot
from benchmarks.measuring import family, processor_seconds, proportional

_SETTLING = 8.0  # [s] for what is on its way to be counted
QUANTILES = ("p50", "p99", "max")


@dataclass(frozen=True)
class Account:
    """What the ledger has of all data topics together."""

    received: int
    accepted: int
    lost: int
    refused: dict[str, int]

    @staticmethod
    def of(values: dict[str, str], topics: dict[str, type]) -> Account:
        """From the stream's diagnostics."""

        def total(what: str) -> int:
            return sum(int(values.get(f"{topic} {what}", 0)) for topic in topics)

        reasons = tuple(f"{topic} {what}: " for topic in topics for what in ("rejected", "dropped"))
        refused = {key: int(count) for key, count in values.items() if key.startswith(reasons)}
        return Account(total("received"), total("accepted"), total("lost"), refused)


class Watched:
    """A node of a robot, with its diagnostics as they come."""

    def __init__(self, stage: Stage, robot: Robot, parameters: dict[str, Any]) -> None:
        self.stage = stage
        self.robot = robot
        self.told: list[tuple[float, dict[str, str]]] = []  # time of day, and the stream's values
        stage.observer.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)
        self.process = stage.node({**robot.parameters, **parameters})

    def _hear(self, array: DiagnosticArray) -> None:
        stream = next(status for status in array.status if status.name.endswith(": stream"))
        self.told.append((time.time(), {pair.key: pair.value for pair in stream.values}))

    @property
    def values(self) -> dict[str, str]:
        """What the stream's diagnostics said last."""
        return self.told[-1][1] if self.told else {}

    @property
    def account(self) -> Account:
        """What the ledger said last."""
        return Account.of(self.values, self.robot.kinds)

    @property
    def memory(self) -> float:
        """Resident [MB], of the solving process too."""
        return sum(map(proportional, family(self.process.pid)))

    @property
    def processor(self) -> float:
        """Seconds used so far, by the solving process too."""
        return sum(map(processor_seconds, family(self.process.pid)))

    @property
    def own_processor(self) -> float:
        """Seconds used so far by the node alone."""
        return processor_seconds(self.process.pid)

    def publish(self, *phases: tuple[float, float]) -> Process:
        """Start to publish: seconds and rates [Hz]."""
        return self.stage.start(
            "benchmarks.load.publisher", self.robot.name, *(f"{seconds}:{rate}" for seconds, rate in phases)
        )

    def settle(self) -> None:
        """Wait until nothing is counted any more."""
        end = time.monotonic() + _SETTLING
        before: list[Account] = []
        while time.monotonic() < end:
            self.stage.observer.spin(1.1)
            before.append(self.account)
            if self.values.get("queue") == "0" and before[-2:] == [before[-1]] * 2:
                return


def sent_by(publisher: Process) -> list[Sent]:
    """What a publisher says it has sent."""
    if publisher.status() != 0:
        raise RuntimeError(publisher.output)
    return [Sent(**json.loads(line)) for line in publisher.output.splitlines() if line.startswith("{")]


@contextmanager
def watched(robot: Robot, parameters: dict[str, Any]) -> Iterator[Watched]:
    """A node on a stage of its own."""
    with TemporaryDirectory() as folder, staged(Path(folder)) as stage:
        yield Watched(stage, robot, parameters)
