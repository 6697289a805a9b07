"""Entry point of ``geomid_feedforward``, the relay that adds efforts to trajectories."""

from __future__ import annotations

import threading

from geomid_ros.ros.main import on_signal, run_program


def main() -> None:
    """Run the relay until SIGINT or SIGTERM; exit status 0, or 2 with one message if it cannot start."""
    run_program("geomid_feedforward", _run)


def _run() -> None:
    import rclpy  # noqa: PLC0415

    from geomid_ros.ros.relay import FeedforwardRelay  # noqa: PLC0415
    from geomid_ros.ros.startup import PAUSE, running_node  # noqa: PLC0415

    stopping = threading.Event()
    on_signal(stopping.set)
    with running_node("geomid_feedforward", automatically_declare_parameters_from_overrides=True) as node:
        relay = FeedforwardRelay(node)
        while not stopping.is_set():
            rclpy.spin_once(node, timeout_sec=PAUSE)
        relay.close()


if __name__ == "__main__":
    main()
