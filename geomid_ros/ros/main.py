"""Entry point of ``geomid_node``: start, spin, and end in an orderly way whatever the signal."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit status 0, or 2 with one message when it cannot start."""
    # The matrices are small: threads of the linear algebra library would only wait for each other. numpy reads this once.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import rclpy  # noqa: PLC0415
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415

    from geomid_ros.errors import GeomidError  # noqa: PLC0415
    from geomid_ros.ros.node import GeomidNode  # noqa: PLC0415

    stopping = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        stopping.set()

    # rclpy's own handlers would invalidate the publishers before the last estimate is out.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        node = GeomidNode()
    except GeomidError as error:
        print(f"geomid_node: {error}", file=sys.stderr)  # noqa: T201
        rclpy.try_shutdown()
        sys.exit(2)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=0.1)
    except ExternalShutdownException:
        pass
    finally:
        node.close()
        executor.remove_node(node)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
