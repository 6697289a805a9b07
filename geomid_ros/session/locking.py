"""Joints that are in no message: locked, where that may be, and said."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import TypeVar

from geomid_ros.errors import InputError
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import NoSamplesError
from geomid_ros.session.session import Session

T = TypeVar("T")


def with_locked(configuration: Configuration, joints: Collection[str]) -> Configuration:
    """The configuration with these joints locked beside its own."""
    return configuration.with_values({"locked_joints": [*configuration["locked_joints"], *joints]})


def locked_note(joints: Iterable[str]) -> str:
    """The sentence on joints that were locked as they are in no message."""
    named = ", ".join(map(repr, joints))
    return f"no message names {named}: locked at zero, as with locked_joints (--lock)"


def read_with_locked(
    make: Callable[[Configuration], Session], configuration: Configuration, read: Callable[[Session], T]
) -> tuple[Session, T]:
    """Read recordings; if they lack joints that may be locked, once more with these locked.

    Args:
        make: makes the session of a configuration.
        configuration: to begin with.
        read: reads the recordings for a session.

    Returns:
        The session, and what was read for it.

    Raises:
        InputError: the recordings cannot be used.
    """
    session = make(configuration)
    try:
        return session, read(session)
    except NoSamplesError as error:
        joints = error.lockable
        if not joints:
            raise
    session = make(with_locked(configuration, joints))
    session.settled.append(locked_note(joints))
    found = read(session)
    if heard := session.joints_heard.intersection(joints):
        raise InputError(
            f"joint '{min(heard)}' is missing in the messages of some recordings and not of others; use those that "
            "have it, or name it in the parameter locked_joints (--lock)"
        )
    return session, found
