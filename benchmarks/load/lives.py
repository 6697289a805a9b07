"""Whole nodes, one after the other in one process: ``COUNT``; says after each what the process holds."""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from benchmarks.load.holdings import holdings
from geomid_ros.ros.node import GeomidNode

_SECONDS = 0.1  # that each is spun


def _live() -> None:
    node, executor = GeomidNode(), SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + _SECONDS
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.02)
    node.close()
    executor.remove_node(node)
    node.destroy_node()
    executor.shutdown()


def main() -> None:
    """Live so many lives."""
    count = int(sys.argv[1])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for _ in range(count):
        _live()
        print(*holdings("self"), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
