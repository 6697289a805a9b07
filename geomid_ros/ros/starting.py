"""Starting ROS. When it cannot start: one sentence that says why, as its arguments and variables are the user's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from geomid_ros.errors import InputError

MATCHING = 0.5
"""A best-effort subscriber hears a publisher a little later than it is seen itself [s]."""

PATIENCE = 5.0
"""What is there is heard or found within this time [s]."""

# Everything is looked for: messages cost less when many come at once, and the filter holds rows back for four times as
# long. To let the executor wait for anything else would wake it for every message.
PAUSE = 0.11
"""[s] between looks for what is asked for, and for a signal."""


@contextmanager
def starting_ros() -> Iterator[None]:
    """Turn an error of rclpy inside into an InputError that names what is wrong or missing."""
    try:
        yield
    except RuntimeError as error:  # rclpy's own are such
        reason = " ".join(str(error).split())
        raise InputError(f"ROS cannot start with these arguments and variables ({reason}){_security()}") from error


@contextmanager
def running_node(name: str, **options: Any) -> Iterator[Node]:
    """A node with these ``options`` of rclpy, as long as ROS runs. Signals are the caller's: rclpy's own handlers would
    invalidate the publishers while they publish."""
    with starting_ros():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with starting_ros():
            node = rclpy.create_node(name, **options)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        try_shutdown()


def _security() -> str:
    """The security that was asked for, as rcl does not always say what it missed."""
    if os.environ.get("ROS_SECURITY_ENABLE") != "true":
        return ""
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE")
    return f". ROS_SECURITY_ENABLE is true, and ROS_SECURITY_KEYSTORE is {keystore or 'not set'}"
