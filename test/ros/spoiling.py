"""Recorded messages with something wrong about them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from files.recordings import Recorded

BETWEEN = 3_000_000  # [ns] later than a good message, earlier than the next


def stamp_of(item: Recorded) -> int:
    """A message's stamp [ns]."""
    stamp = item.message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamped(item: Recorded, stamp: int) -> Recorded:
    """The same message with another stamp [ns]."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    header = item.message.header
    return item.changed(header=replace(header, stamp=replace(header.stamp, sec=sec, nanosec=nanosec)))


def later(item: Recorded, nanoseconds: int) -> Recorded:
    """The same message with a later stamp."""
    return stamped(item, stamp_of(item) + nanoseconds)


def changed(item: Recorded, **fields: Any) -> Recorded:
    """The message with other numbers, on a stamp of its own between two good ones."""
    return later(item.changed(**fields), BETWEEN)


def entry(item: Recorded, key: str, place: int, value: float) -> Recorded:
    """The message with another number in one place, on a stamp of its own."""
    values = getattr(item.message, key).copy()
    values[place] = value
    return changed(item, **{key: values})


def in_frame(item: Recorded, frame: str) -> Recorded:
    """A wrench that says that it is given in another frame."""
    return item.changed(header=replace(item.message.header, frame_id=frame))


def with_force(item: Recorded, **force: float) -> Recorded:
    """A wrench with other forces, on a stamp of its own."""
    wrench = item.message.wrench
    return changed(item, wrench=replace(wrench, force=replace(wrench.force, **force)))
