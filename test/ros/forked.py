"""Processes that are forked from one that has imported everything: to import it takes longer than most tests."""

from __future__ import annotations

import gc
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from multiprocessing import forkserver, get_context
from pathlib import Path
from unittest.mock import patch

from commands.running import as_estimated
from matplotlib.figure import Figure

from geomid_ros.api.identify import Identification
from geomid_ros.estimation import identifier
from geomid_ros.excitation.search import Search
from geomid_ros.live import supervisor
from geomid_ros.report import drawing, excitation

_context = get_context("forkserver")
_context.set_forkserver_preload(
    [
        "geomid_ros.api.excite",
        "geomid_ros.api.identify",
        "geomid_ros.commands",
        "geomid_ros.commands.recording_results",
        "geomid_ros.commands.excite",
        "geomid_ros.ros.excite",
        "geomid_ros.ros.node",
        "geomid_ros.ros.player",
        "matplotlib.backends.backend_agg",
    ]
)


class Forked:
    """``python -m``, with what is used here of :class:`subprocess.Popen`."""

    def __init__(self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str], log: Path) -> None:
        self._process = _context.Process(target=_run, args=(arguments, folder, dict(environment), log))
        with patch.dict(os.environ, environment):  # the server, which the first process starts, imports from there
            self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def poll(self) -> int | None:
        """Its exit status, None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Its exit status, when it has ended."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("forked", timeout or 0.0)
        return self._process.exitcode

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it, whatever it is at."""
        self._process.kill()


def _run(arguments: Sequence[str], folder: Path, environment: dict[str, str], log: Path) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[:0] = [path for path in environment["PYTHONPATH"].split(os.pathsep) if path not in sys.path]
    with log.open("ab") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    gc.freeze()
    _spare()
    sys.argv = list(arguments)
    runpy.run_module(arguments[0], run_name="__main__", alter_sys=True)


def _spare() -> None:
    """A machine that is busy makes nothing wrong: what is to be judged by time has its own (``faulty.py``).
    Motions need not be the best, and nobody looks at pictures, nor at what is made of results."""
    supervisor.HANGING = 3600.0
    Search.improved = lambda self, motion, *_: self.feasibility.shrunk_to_feasible(motion, self.halvings)
    drawing.draw_identification = excitation.motion_figure = lambda *_: Figure((1.0, 1.0))
    identifier.estimate, Identification._remainder = as_estimated, lambda *_: None


def end_server() -> None:
    """End the process that has imported everything, and wait for it: who measures this one's time is to see its."""
    forkserver._forkserver._stop()
