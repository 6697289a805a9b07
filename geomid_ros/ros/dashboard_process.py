"""The dashboard of a node, in a process of its own: it cannot keep the node from its messages, and ends with it."""

from __future__ import annotations

import signal
from importlib.util import find_spec
from multiprocessing import get_context

from geomid_ros.errors import InputError
from geomid_ros.live.threads import end_with_parent

_PATIENCE = 0.5  # [s] for its end


class DashboardProcess:
    """Shows a node on a local page, see :func:`~geomid_ros.ros.dashboard_listener.run_dashboard`."""

    def __init__(self, node: str) -> None:
        """Start it for the node of this full name. Raises InputError where the library that it needs is missing."""
        if find_spec("tornado") is None:
            raise InputError("the parameter dashboard needs Tornado, which is not installed (pip install tornado)")
        self._process = get_context("spawn").Process(target=_run, args=(node,), daemon=True)
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # in the process, too: Ctrl+C is the node's
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.join(_PATIENCE)
        self._process.kill()


def _run(node: str) -> None:
    from geomid_ros.ros.dashboard_listener import run_dashboard  # noqa: PLC0415 not in the node's process

    end_with_parent()
    run_dashboard(node, None, lambda said: print(said, flush=True))
