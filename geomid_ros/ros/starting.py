"""When ROS cannot start: one sentence that says why, as its arguments and variables are the user's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from geomid_ros.errors import InputError


@contextmanager
def starting_ros() -> Iterator[None]:
    """Turn an error of rclpy inside into an InputError that names what is wrong or missing."""
    try:
        yield
    except RuntimeError as error:  # rclpy's own are such
        reason = " ".join(str(error).split())
        raise InputError(f"ROS cannot start with these arguments and variables ({reason}){_security()}") from error


def _security() -> str:
    """The security that was asked for, as rcl does not always say what it missed."""
    if os.environ.get("ROS_SECURITY_ENABLE") != "true":
        return ""
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE")
    return f". ROS_SECURITY_ENABLE is true, and ROS_SECURITY_KEYSTORE is {keystore or 'not set'}"
