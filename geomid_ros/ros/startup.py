"""Starts ROS. If it cannot start, one sentence states why, as its arguments and variables are the user's."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from geomid_ros.errors import InputError

MATCHING = 0.5
"""Time [s] from the discovery of a best-effort subscriber until it receives messages."""

PATIENCE = 5.0
"""Time [s] within which existing nodes and topics are discovered, and the last messages are received."""

POLL = 5e-3
"""Time [s] between polls for messages that are to be processed at once; each poll costs as much as a message."""

# Everything is polled: messages cost less when many come at once, and the filter delays rows by four times as
# long. If the executor waited for anything else, every message would wake it.
PAUSE = 0.11
"""Time [s] between polls for requests and signals."""


@contextmanager
def starting_ros() -> Iterator[None]:
    """Convert an error of rclpy inside into an InputError that names the problem."""
    try:
        yield
    except RuntimeError as error:  # raised by rclpy
        reason = " ".join(str(error).split())
        raise InputError(f"ROS cannot start with these arguments and variables ({reason}){_security()}") from error
    except ValueError as error:
        raise InputError(f'a parameter has no value; an empty list is written as [""] ({error})') from error


def check_arguments() -> None:
    """Raise InputError for arguments of this process that ROS would ignore."""
    with starting_ros():
        others = remove_ros_args(sys.argv)[1:]
    if others:
        raise InputError(
            f"{' '.join(others)}: not an argument of ROS; parameters go behind --ros-args, as -p NAME:=VALUE or "
            "--params-file FILE (docs/pages/reference.md)"
        )


@contextmanager
def running_ros() -> Iterator[None]:
    """Run ROS inside the context. Signals are handled by the caller: rclpy's handlers would invalidate the publishers
    while they publish."""
    with starting_ros():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        try_shutdown()


@contextmanager
def running_node(name: str, **options: Any) -> Iterator[Node]:
    """Run ROS and a node with these ``options`` of rclpy. It ends as soon as its last messages have been received: with
    its publishers they would be lost."""
    with running_ros():
        with starting_ros():
            node = rclpy.create_node(name, **options)
        try:
            yield node
        finally:
            end = time.monotonic() + PATIENCE
            for publisher in node.publishers:
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))
            node.destroy_node()


def _security() -> str:
    """Describe the requested security, as rcl does not always state what it missed."""
    if os.environ.get("ROS_SECURITY_ENABLE") != "true":
        return ""
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE")
    return f". ROS_SECURITY_ENABLE is true, and ROS_SECURITY_KEYSTORE is {keystore or 'not set'}"
