"""Processes of this package, each with its log, ended by their own number."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

import geomid_ros

from .forked import Forked

SOON = 2.0  # [s] in which a node ends, whatever it is at
PATIENCE = 60.0  # [s] after which a process that should end is taken to hang
LONGEST = 300.0  # [s] the same, however busy the machine is


class Process:
    """A Python module of this package that runs in a ROS domain."""

    def __init__(self, domain: int, folder: Path, arguments: Sequence[str | Path], fresh: bool) -> None:
        """``folder`` becomes its working directory; its log lies beside. ``fresh``: started as a user does."""
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder.with_suffix(f".{len(list(folder.parent.glob('*.log')))}.log")
        package = str(Path(geomid_ros.__file__).parents[1])
        # The environment as a whole: ROS from PyPI has prepared it for this process, and would do so again for a part.
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
        line = [str(argument) for argument in arguments]
        self.log.touch()
        self._process: Forked | subprocess.Popen[bytes]
        if fresh:
            with self.log.open("wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", *line],
                    cwd=folder,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                )
        else:
            self._process = Forked(line, folder, environment, self.log)

    @property
    def output(self) -> str:
        """What it has printed so far."""
        return self.log.read_text(errors="replace")

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def status(self) -> int:
        """Its exit status, when it has ended."""
        self.seconds_to_end()
        return self._process.wait()

    def seconds_to_end(self, number: signal.Signals | None = None) -> float:
        """How long it takes to end after a signal, or from now on, but for what its threads wait for a processor."""
        begin, before = time.monotonic(), self.waits(children=True)
        if number is not None:
            self.send(number)
        waits, seconds = before, 0.0
        while self.running:
            if seconds > PATIENCE or time.monotonic() - begin > LONGEST:
                self._process.kill()
                self._process.wait()
                raise AssertionError(f"still running after {time.monotonic() - begin:.0f} s:\n{self.output}")
            time.sleep(0.01)
            waits = {**waits, **self.waits(children=True)}
            waited = sum(wait - before.get(thread, 0.0) for thread, wait in waits.items())
            seconds = time.monotonic() - begin - waited
        return seconds

    def waits(self, *, children: bool = False) -> dict[str, float]:
        """How long [s] each thread could have run, had the machine had a processor to spare; ``children``: also those
        of the processes that it has started, for which it may wait."""
        waits, pids = {}, [str(self.pid)]
        while pids:
            with suppress(OSError):  # the process has just ended
                for thread in Path(f"/proc/{pids.pop()}/task").iterdir():
                    with suppress(OSError):  # the thread has just ended
                        waits[thread.name] = 1e-9 * int((thread / "schedstat").read_bytes().split()[1])
                        pids += (thread / "children").read_text().split() if children else []
        return waits

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Ask it to end; its exit status."""
        if self.running:
            self.send(number)
        return self.status()


def parameter_file(folder: Path, parameters: dict[str, Any]) -> Path:
    """A parameter file for every node."""
    path = folder / "parameters.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}), encoding="utf-8")
    return path
