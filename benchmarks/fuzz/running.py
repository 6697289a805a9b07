"""Workers for the inputs of a target, one after the other where one dies, and what came of them."""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_PATIENCE = 300.0  # [s] at one input, after which a worker hangs; on a busy machine it may get little of the processor


@dataclass
class Outcome:
    """What a target's inputs came to: counts by result; failures as (input, what happened); the ``slowest`` input's
    time [s of the processor] and number; ``memory`` that the process grew by at most [bytes]."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[tuple[int, str]] = field(default_factory=list)
    slowest: tuple[float, int] = (0.0, 0)
    memory: int = 0

    def take(self, told: dict[str, Any]) -> None:
        """Take in a line that a worker says."""
        if "failure" in told:
            self.failures.append((told["index"], told["failure"]))
            return
        self.counts.update(told["counts"])
        self.slowest = max(self.slowest, (told["slowest"][0], told["slowest"][1]))
        self.memory = max(self.memory, told["memory"])


def run(name: str, first: int, end: int, folder: Path, outcome: Outcome) -> Iterator[int]:
    """Try the inputs from ``first`` to before ``end`` of a target; yields how many have been tried, now and then."""
    begin = first
    while begin < end:
        command = [sys.executable, "-m", "benchmarks.fuzz.worker", name, str(begin), str(end), str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as worker:  # noqa: S603 a command of ours
            for line in _lines(worker, worker.stdout, folder / "at"):
                outcome.take(json.loads(line))
                yield outcome.counts.total()
        if worker.returncode == 0:
            return
        at = folder / "at"
        if not at.exists():
            raise RuntimeError(f"the worker for {name} does not start")
        index = int(at.read_text())
        outcome.failures.append((index, f"the process ended with status {worker.returncode}"))
        begin = index + 1
        outcome.counts.update(died=1, untold=begin - first - 1 - outcome.counts.total())


def _lines(worker: subprocess.Popen[str], output: Any, at: Path) -> Iterator[str]:
    """What a worker says; if it stays at one input for long, it is ended."""
    before = None
    with selectors.DefaultSelector() as selector:
        selector.register(output, selectors.EVENT_READ)
        while True:
            if selector.select(_PATIENCE):
                line = output.readline()
                if not line:
                    return
                yield line
                continue
            now = at.read_text() if at.exists() else ""
            if now == before:
                break
            before = now
    worker.kill()
