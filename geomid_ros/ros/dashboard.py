"""Dashboard: a node that only subscribes to diagnostics, and a process for it beside the node that it shows."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from importlib.util import find_spec
from multiprocessing import get_context

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from geomid_ros.errors import InputError
from geomid_ros.live.threads import PATIENCE, end_with_parent
from geomid_ros.ros.startup import PAUSE, running_node


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
    from geomid_ros.live.dashboard import served_board, state_of  # noqa: PLC0415 the node does not load its library

    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    async with served_board(node, port) as (board, address):
        handle = listener.create_subscription(DiagnosticArray, "/diagnostics", lambda _: None, 100).handle
        say(f"Dashboard of /{node}: {address}")
        while not stop.is_set():
            with handle:
                while (taken := handle.take_message(DiagnosticArray, False)) is not None:
                    if (state := state_of(node, taken[0].status)) is not None:
                        board.show(state)
            await asyncio.sleep(PAUSE)


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
        self._process.join(PATIENCE)
        self._process.kill()


def _run_process(node: str) -> None:
    end_with_parent()
    run_dashboard(node, None, lambda said: print(said, flush=True))
