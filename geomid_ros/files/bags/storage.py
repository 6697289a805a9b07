"""What the formats of recordings have in common."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from geomid_ros.errors import InputError


class RawMessage(NamedTuple):
    """A serialised message: its topic, time of recording [ns], type and bytes."""

    topic: str
    time: int
    kind: str
    data: bytes


class Storage(Protocol):
    """An open file of a recording.

    ``cut`` says where the file is cut off and how much of it is whole, empty if all is; ``checked``: whether it has
    checksums, by which damage to its numbers is seen.
    """

    cut: str
    checked: bool

    @property
    def counts(self) -> Mapping[tuple[str, str], int]:
        """How many messages there are, by topic and type."""

    @property
    def start(self) -> int | None:
        """When the first message was recorded [ns]."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Everything on ``topics`` in the order of recording. Raises InputError naming the file."""

    def close(self) -> None:
        """Close the file."""


class FaultError(Exception):
    """A fault in a file, with the ``offset`` of its byte if that is known."""

    def __init__(self, why: str, offset: int | None = None) -> None:
        super().__init__(why)
        self.offset = offset


class TornError(FaultError):
    """The file ends too early: its recorder was killed, or it was not copied to its end. What it has is whole."""


@dataclass(frozen=True)
class Part:
    """The readable part of a damaged file: ``count`` messages, the last at ``time`` [ns]; ``rescue`` says how to
    recover them."""

    count: int
    time: int
    rescue: str

    def __str__(self) -> str:
        if not self.count:
            return "No message before that can be read"
        return f"Only a part is readable: {self.count} messages, up to {self.time * 1e-9:.3f} s. {self.rescue}"


def damaged(path: Path, fault: FaultError, part: Part) -> InputError:
    """The error for a file with this fault, and this part that can still be read."""
    return InputError(f"{path}: cannot be read as a rosbag2 recording: damaged{_place(fault)}, {fault}. {part}")


def cut_off(path: Path, fault: FaultError, count: int, time: int) -> str:
    """The sentence on a file that ends too early, with ``count`` whole messages, the last at ``time`` [ns]."""
    whole = f"its {count} intact messages are read, up to {time * 1e-9:.3f} s" if count else "it has no intact message"
    return f"{path}: truncated{_place(fault)}, {fault}; {whole}"


def _place(fault: FaultError) -> str:
    return "" if fault.offset is None else f" at byte {fault.offset}"
