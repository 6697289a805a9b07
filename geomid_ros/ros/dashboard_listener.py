"""The dashboard's ears: a node that hears diagnostics and says nothing."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from geomid_ros.live.dashboard_server import Board, serve
from geomid_ros.live.dashboard_state import Diagnosis, state_of
from geomid_ros.live.threads import start_daemon
from geomid_ros.ros.starting import running_node

_PAUSE = 0.2  # [s] after which its end is noticed at the latest


def run_dashboard(node: str, port: int | None, say: Callable[[str], None]) -> None:
    """Show a node on a local page, until SIGINT or SIGTERM.

    Args:
        node: its full name.
        port: of the page; None: the usual one, or if that is taken any other.
        say: is told the address.

    Raises:
        InputError: ROS cannot start, or the port is taken.
    """
    options = {"use_global_arguments": False, "enable_rosout": False, "start_parameter_services": False}
    with running_node("geomid_dashboard", **options) as listener:
        asyncio.run(_run(node.lstrip("/"), port, say, listener))


async def _run(node: str, port: int | None, say: Callable[[str], None], listener: Node) -> None:
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
    hearing = start_daemon("dashboard", _hear, listener, ending)
    try:
        await serve(node, port, begin, stop)
    finally:
        ending.set()
        await asyncio.to_thread(hearing.join)  # while there is what it uses


def _hear(listener: Node, ending: threading.Event) -> None:
    while not ending.is_set():
        rclpy.spin_once(listener, timeout_sec=_PAUSE)


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
