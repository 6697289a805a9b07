"""Decodes serialised messages to blocks of numbers. The layout of a message serves all that differ only in numbers."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.signals.messages import COMMANDS, JOINT_STATES, ODOM, Block, message_type, parse
from geomid_ros.signals.settings import MOST_KINDS
from geomid_ros.types import AnyArray, BoolArray, IntArray

LITTLE_ENDIAN = b"\0\1"
Raw: TypeAlias = tuple[str, bytes, *tuple[Any, ...]]
"""A message as received: its topic's name in the pipeline, its bytes (CDR), and any further data."""


_without_rosbags: list[Any] = []


def read_without_rosbags(types: Any) -> None:
    """Let ``types.deserialize_cdr(data, kind)`` read messages where rosbags is not installed, as on a robot."""
    _without_rosbags[:] = [types]


@cache
def message_types() -> Any:
    """Return the reader of messages by the definitions of ROS 2 Jazzy: ``deserialize_cdr(data, kind)``.

    Raises:
        ModuleNotFoundError: rosbags is not installed, and there is no other reader.
    """
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 where it is installed
    except ModuleNotFoundError:
        if not _without_rosbags:
            raise
        return _without_rosbags[0]
    return get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class _Layout:
    """Places of the numbers in messages of one size with the same texts and lengths.

    ``fixed`` are the places of the bytes that all messages share with ``like``, and ``text`` these bytes; ``form`` has
    the stamp in its first two fields, and then the arrays.
    """

    like: Block
    fixed: IntArray
    text: AnyArray
    form: np.dtype[np.void]

    def matches(self, data: AnyArray) -> BoolArray:
        """True for messages ``(N, size)`` with this layout ``(N,)``."""
        matching: BoolArray = (data[:, self.fixed] == self.text).all(axis=1)
        return matching

    def block(self, data: AnyArray, order: IntArray) -> Block:
        """Return the numbers of messages ``(N, size)``."""
        records = data.view(self.form)[:, 0]
        seconds, nanoseconds, *arrays = (records[field] for field in self.form.names or ())
        stamps = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
        stamps[(seconds >= 1 << 31) | (nanoseconds >= 1_000_000_000)] = -1
        return Block(self.like.topic, order, stamps, self.like.names, tuple(arrays))


class Decoder:
    """Decodes messages of several topics, and remembers their layouts."""

    def __init__(self) -> None:
        self._layouts: dict[tuple[str, int], list[_Layout]] = {}  # by topic and size

    def blocks(self, messages: Sequence[Raw], refuse: Callable[[int, str], None]) -> list[Block]:
        """Decode messages into as few blocks as possible.

        Args:
            messages: messages in their order of arrival.
            refuse: ``refuse(place, why)`` receives messages that are not of their topic's type.
        """
        groups: defaultdict[tuple[str, int], list[int]] = defaultdict(list)
        for place, message in enumerate(messages):
            groups[message[0], len(message[1])].append(place)
        return [block for group, places in groups.items() for block in self._decoded(group, places, messages, refuse)]

    def _decoded(
        self,
        group: tuple[str, int],
        places: list[int],
        messages: Sequence[Raw],
        refuse: Callable[[int, str], None],
    ) -> list[Block]:
        """Decode the messages of one topic and size."""
        data = np.frombuffer(b"".join([messages[place][1] for place in places]), np.uint8).reshape(len(places), -1)
        remaining, blocks = np.array(places), []
        layouts = deque(self._layouts.get(group, ()))
        while len(remaining):
            if not layouts:
                place = int(remaining[0])
                data, remaining = data[1:], remaining[1:]
                try:
                    block, layout = _parsed(messages[place], place)
                except ValueError as error:
                    refuse(place, str(error))
                    continue
                blocks.append(block)
                if layout is not None:
                    self._remember(group, layout)
                    layouts.append(layout)
            else:
                layout = layouts.popleft()
                same = layout.matches(data)
                if same.any():
                    blocks.append(layout.block(data[same], remaining[same]))
                    data, remaining = data[~same], remaining[~same]
        return blocks

    def _remember(self, group: tuple[str, int], layout: _Layout) -> None:
        if sum(map(len, self._layouts.values())) >= MOST_KINDS:  # bounded, as the sender decides how many there are
            self._layouts.clear()
        self._layouts.setdefault(group, []).append(layout)


def _parsed(raw: Raw, place: int) -> tuple[Block, _Layout | None]:
    """Parse a message. Return it and its layout, None if that is not understood. Raises ValueError with the reason."""
    topic, data, *_ = raw
    types = message_types()
    try:
        message = types.deserialize_cdr(data, message_type(topic))
        block = Block.of(parse(topic, message), place)
    except Exception as error:  # parsing malformed bytes may raise anything
        raise ValueError((str(error).splitlines() or [type(error).__name__])[0]) from error
    if data[:2] != LITTLE_ENDIAN:
        return block, None
    return block, _layout(topic, data, message, block)


def _layout(topic: str, data: bytes, message: Any, block: Block) -> _Layout | None:
    """Return the layout of a message; None if its numbers are not at the expected places."""
    fixed, place = [slice(0, 2)], 12
    texts = [message.header.frame_id, *([message.child_frame_id] if topic == ODOM else ())]
    for text in texts:
        place = _after_text(place, text, fixed)
    if topic in (JOINT_STATES, COMMANDS):
        place = _after_count(place, fixed)
        for text in message.name:
            place = _after_text(place, text, fixed)
    formats: list[Any] = ["<u4", "<u4"]  # seconds and nanoseconds
    offsets = [4, 8]
    for array in block.arrays:
        if topic in (JOINT_STATES, COMMANDS):
            place = _after_count(place, fixed)
        count = array.shape[1]
        begin = _aligned(place, 8) if count else place
        formats.append(("<f8", (count,)))
        offsets.append(begin)
        place = begin + 8 * count
    places = np.concatenate([np.arange(part.start, part.stop) for part in fixed])
    if place > len(data):
        return None
    record = np.frombuffer(data, np.uint8)[None]
    names = [*map(str, range(len(formats)))]
    form = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(data)})
    layout = _Layout(block, places, record[0, places], form)
    decoded = layout.block(record, block.order)
    same = all(a.tobytes() == b.tobytes() for a, b in zip(decoded.arrays, block.arrays, strict=True))
    return layout if same and decoded.stamps[0] == block.stamps[0] else None


def _aligned(place: int, size: int) -> int:
    """Next place of a number of this size; CDR counts from the fifth byte."""
    return place + (4 - place) % size


def _after_text(place: int, text: str, fixed: list[slice]) -> int:
    begin = _aligned(place, 4)
    fixed.append(slice(begin, begin + 4 + len(text.encode()) + 1))
    return int(fixed[-1].stop)


def _after_count(place: int, fixed: list[slice]) -> int:
    begin = _aligned(place, 4)
    fixed.append(slice(begin, begin + 4))
    return begin + 4
