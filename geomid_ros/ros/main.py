"""Entry point of ``geomid_node``: start, spin, and end in order on any signal."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from geomid_ros.errors import (
    TOO_LITTLE_MEMORY,
    GeomidError,
    check_memory,
    is_lack_of_memory,
    load_hashes,
    missing_library,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from geomid_ros.live.solving_process import SolvingProcess
    from geomid_ros.ros.node import GeomidNode

_SWITCH_INTERVAL = 5e-4  # [s]


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit status 0, or 2 with one message when it cannot start."""
    # So long, not the usual 5 ms, a solver in the middle of Python code may keep the intake waiting.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    started("geomid_node", _run)


def started(name: str, run: Callable[[], None]) -> None:
    """Run a program of this ``name``; what keeps it from starting is one message, and exit status 2."""
    # Imports take longer than a user who ends the node may want to wait; there is nothing to lose yet.
    on_signal(lambda: os._exit(0))
    try:
        check_memory()
        load_hashes()
        run()
    except GeomidError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(2)
    except (MemoryError, ImportError, OSError) as error:
        sentence = TOO_LITTLE_MEMORY if is_lack_of_memory(error) else missing_library(error)
        if not sentence:
            raise
        print(f"{name}: {sentence}", file=sys.stderr)
        sys.stderr.flush()
        os._exit(2)  # libraries that are half loaded crash when they are unloaded


def on_signal(act: Callable[[], object]) -> None:
    """What SIGINT and SIGTERM do from now on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: act())


def _run() -> None:
    from geomid_ros.live.solving_process import SolvingProcess  # noqa: PLC0415

    with closing(SolvingProcess()) as solving:  # first, as ROS starts threads
        _run_node(solving)


def _run_node(solving: SolvingProcess) -> None:
    import rclpy  # noqa: PLC0415
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415
    from rclpy.utilities import ok, try_shutdown  # noqa: PLC0415

    from geomid_ros.ros.node import GeomidNode  # noqa: PLC0415
    from geomid_ros.ros.starting import PAUSE, starting_ros  # noqa: PLC0415

    # rclpy's own handlers would invalidate the publishers before the last estimate is out.
    stopping = threading.Event()
    on_signal(stopping.set)
    with starting_ros():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = GeomidNode(solving)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            while ok() and not stopping.is_set():
                _guarded(node, node.take_waiting)
                _guarded(node, partial(executor.spin_once, timeout_sec=0.0))
                _guarded(node, partial(node.wait, PAUSE))
            _guarded(node, node.take_waiting)
        finally:
            node.close()
            executor.remove_node(node)
            node.destroy_node()
    finally:
        try_shutdown()


def _guarded(node: GeomidNode, run: Callable[[], object]) -> None:
    """Run something. An error in it is reported, and the node lives on."""
    try:
        run()
    except Exception as error:  # noqa: BLE001 the other callbacks go on
        node.fail("a callback failed", error)


if __name__ == "__main__":
    main()
