"""Entry point of ``geomid_node``: starts, spins, and ends in order on any signal."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from geomid_ros.errors import check_memory, error_message

if TYPE_CHECKING:
    from collections.abc import Callable

    from geomid_ros.live.solving_process import SolvingProcess
    from geomid_ros.ros.node import GeomidNode

_SWITCH_INTERVAL = 5e-4  # [s]


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit status 0, or 2 with one message if it cannot start."""
    run_program("geomid_node", _run)


def run_program(name: str, run: Callable[[], None]) -> None:
    """Run a program of this ``name``; an error at its start is one message, and exit status 2."""
    # Instead of the default 5 ms, another thread in Python code may block the intake for this time only.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    # End at once during imports, which take long; there are no data to lose yet.
    on_signal(lambda: os._exit(0))
    try:
        check_memory()
        from geomid_ros.ros.startup import check_arguments  # noqa: PLC0415

        check_arguments()
        run()
    except Exception as error:  # libraries raise various errors when memory runs out
        if not (sentence := error_message(error)):
            raise
        print(f"{name}: {sentence}", file=sys.stderr)
        sys.stderr.flush()
        os._exit(2)  # partly loaded libraries crash when unloaded, and a signal meanwhile would be the status


def on_signal(act: Callable[[], object]) -> None:
    """Call ``act`` on SIGINT and SIGTERM from now on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: act())


def _run() -> None:
    from geomid_ros.live.solving_process import SolvingProcess  # noqa: PLC0415

    with closing(SolvingProcess()) as solving:  # first, as ROS starts threads
        _run_node(solving)


def _run_node(solving: SolvingProcess) -> None:
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.utilities import ok  # noqa: PLC0415

    from geomid_ros.ros.node import GeomidNode  # noqa: PLC0415
    from geomid_ros.ros.startup import PAUSE, running_ros  # noqa: PLC0415

    stopping = threading.Event()
    on_signal(stopping.set)
    with running_ros():
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


def _guarded(node: GeomidNode, run: Callable[[], object]) -> None:
    """Run a function. Its errors are reported, and the node survives."""
    try:
        run()
    except Exception as error:  # noqa: BLE001 the other callbacks go on
        node.fail("a callback failed", error)


if __name__ == "__main__":
    main()
