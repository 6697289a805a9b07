"""Dashboard: a node that only subscribes to diagnostics, and a process for it beside the node that it shows."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable
from importlib.util import find_spec
from multiprocessing import get_context
from typing import TYPE_CHECKING

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from geomid_ros.errors import InputError
from geomid_ros.live.dashboard_state import Diagnosis, state_of
from geomid_ros.live.threads import end_with_parent, start_daemon
from geomid_ros.ros.startup import PAUSE, running_node

if TYPE_CHECKING:
    from geomid_ros.live.dashboard_server import Board

_PATIENCE = 0.5  # [s] for its process to end


def run_dashboard(node: str, port: int | None, say: Callable[[str], None]) -> None:
    """Show a node on a local page, until SIGINT or SIGTERM.

    Args:
        node: its full name.
        port: of the page; None: the default port, or any free port if that is taken.
        say: receives a line with the address.

    Raises:
        InputError: ROS cannot start, or the port is taken.
    """
    options = {"use_global_arguments": False, "enable_rosout": False, "start_parameter_services": False}
    with running_node("geomid_dashboard", **options) as listener:
        asyncio.run(_run(node.lstrip("/"), port, say, listener))


async def _run(node: str, port: int | None, say: Callable[[str], None], listener: Node) -> None:
    from geomid_ros.live.dashboard_server import serve  # noqa: PLC0415 the node's process does not load its library

    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)

    def begin(board: Board, address: str) -> None:
        def take(message: DiagnosticArray) -> None:
            state = state_of(node, _diagnoses(message))
            if state is not None:
                loop.call_soon_threadsafe(board.show, state)

        listener.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
        say(f"Dashboard of /{node}: {address}")

    ending = threading.Event()
    thread = start_daemon("dashboard", _spin, listener, ending)
    try:
        await serve(node, port, begin, stop)
    finally:
        ending.set()
        await asyncio.to_thread(thread.join)  # while the objects that it uses exist


def _spin(listener: Node, ending: threading.Event) -> None:
    while not ending.is_set():
        rclpy.spin_once(listener, timeout_sec=PAUSE)


def _diagnoses(message: DiagnosticArray) -> list[Diagnosis]:
    return [
        Diagnosis(
            status.name,
            int.from_bytes(status.level, "little"),
            status.message,
            {pair.key: pair.value for pair in status.values},
        )
        for status in message.status
    ]


class DashboardProcess:
    """Process that shows a node on a local page; see :func:`run_dashboard`."""

    def __init__(self, node: str) -> None:
        """Start the process for the node of this full name. Raises InputError if its library is missing."""
        if find_spec("tornado") is None:
            raise InputError("the parameter dashboard needs Tornado, which is not installed (pip install tornado)")
        self._process = get_context("spawn").Process(target=_run_process, args=(node,), daemon=True)
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # in the process, too: the node has Ctrl+C
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join(_PATIENCE)
        self._process.kill()


def _run_process(node: str) -> None:
    end_with_parent()
    run_dashboard(node, None, lambda said: print(said, flush=True))
