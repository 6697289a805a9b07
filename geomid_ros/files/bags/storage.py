"""Base class of recording formats, and decompression into bounded memory.

A few kilobytes can be crafted to unpack to gigabytes.
"""

from __future__ import annotations

import shutil
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from geomid_ros.errors import InputError
from geomid_ros.files.disk import MOST_BYTES


class RawMessage(NamedTuple):
    """A serialised message: its topic, recording time [ns], type and bytes."""

    topic: str
    time: int
    kind: str
    data: bytes


class FaultError(Exception):
    """A fault in a file, with the ``offset`` of its byte if known."""

    def __init__(self, why: str, offset: int | None = None) -> None:
        super().__init__(why)
        self.sentence = f", {why}" if offset is None else f" at byte {offset}, {why}"


class TruncatedFileError(FaultError):
    """The file ends too early: its recorder was killed, or its copy is incomplete. The existing part is intact."""


class Storage(ABC):
    """An open file of a recording, which was examined completely.

    ``counts``: number of messages by topic and type; ``start``: recording time of the first one [ns]. ``truncation``
    states where the file ends too early and how much of it is intact; empty if it is complete. ``has_checksums`` is
    True if it has checksums, which reveal damaged numbers.

    Raises InputError naming the file, the place of damage if known, and how much can be read.
    """

    recovery_hint = ""
    """Advice on recovering a part of a damaged file."""

    def __init__(self, path: Path) -> None:
        self._path, self._size = path, path.stat().st_size
        self.counts: dict[tuple[str, str], int] = {}
        self.start: int | None = None
        self.truncation, self.has_checksums = "", True
        try:
            self._examine()
        except TruncatedFileError as fault:
            self.truncation = self._truncated(fault, *self._whole())
        except FaultError as fault:
            error = self._damaged(fault, *self._whole())
            self.close()
            raise error from fault

    @abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield everything on ``topics`` in the order of recording. Raises InputError naming the file."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    @abstractmethod
    def _examine(self) -> None:
        """Open and examine the whole file. Raises FaultError."""

    @abstractmethod
    def _whole(self) -> tuple[int, int]:
        """Number of readable messages in a file with a fault, and the recording time of the last one [ns]."""

    def _damaged(self, fault: FaultError, count: int, time: int) -> InputError:
        part = f"Only a part is readable: {count} messages, up to {time * 1e-9:.3f} s. {self.recovery_hint}"
        readable = part if count else "No message before that can be read"
        return InputError(f"{self._path}: cannot be read as a rosbag2 recording: damaged{fault.sentence}. {readable}")

    def _truncated(self, fault: FaultError, count: int, time: int) -> str:
        intact = f"its {count} intact messages are read, up to {time * 1e-9:.3f} s"
        return f"{self._path}: truncated{fault.sentence}; {intact if count else 'it has no intact message'}"


METHODS = ("zstd", "lz4")
"""Supported compression methods."""

_MOST_RATIO = 300  # maximum compression ratio of a file; no recording of times and noise comes near it
_LEFT_FREE = 500_000_000  # bytes that stay free on a disk, as others may need them
PIECE = 1 << 16
"""Bytes of a file that are read at once. Of a truncated compressed file, less than that is lost."""


@cache
def _library(method: str) -> Any:
    """Module that unpacks ``method``. It is imported for the first recording only: a node on a robot reads none."""
    if method == "lz4":
        import lz4.frame  # type: ignore[import-untyped] # noqa: PLC0415

        return lz4.frame
    if sys.version_info >= (3, 14):
        from compression import zstd  # noqa: PLC0415
    else:
        from backports import zstd  # noqa: PLC0415
    return zstd


def decompress(data: bytes | memoryview, method: str, size: int) -> bytes | memoryview:
    """Unpack data compressed with ``method`` (zstd, lz4 or empty for none) to exactly ``size`` bytes.

    Raises ValueError if they cannot be unpacked, or are too large.
    """
    if size > MOST_BYTES:
        raise ValueError(f"{size} bytes unpacked from {len(data)}, more than the maximum of {MOST_BYTES}")
    result = _unpacked(data, method, size + 1) if method else data
    if len(result) != size:
        length = "more" if len(result) > size else len(result)
        raise ValueError(f"expected {size} unpacked bytes, found {length}")
    return result


def decompress_truncated(data: bytes | memoryview, method: str, size: int) -> bytes | memoryview:
    """Unpack the beginning of compressed ``data`` whose end is missing. Raises ValueError."""
    most = min(size, MOST_BYTES)
    return _unpacked(data, method, most, truncated=True) if method else data[:most]


def decompress_message(data: bytes, method: str) -> bytes:
    """Unpack a message that was compressed by itself. Raises ValueError if it cannot be unpacked, or is too large."""
    result = _unpacked(data, method, MOST_BYTES + 1)
    if len(result) > MOST_BYTES:
        raise ValueError(f"a message unpacks to more than {MOST_BYTES} bytes")
    return result


def _unpacked(data: bytes | memoryview, method: str, most: int, *, truncated: bool = False) -> bytes:
    """Unpack at most this many bytes; only ``truncated`` data may end too early."""
    if method not in METHODS:
        raise ValueError(f"its compression is {method[:20]!r}, expected zstd, lz4 or none")
    library = _library(method)
    unpacker = library.ZstdDecompressor() if method == "zstd" else library.LZ4FrameDecompressor()
    with _damage_named(method):
        result: bytes = unpacker.decompress(data, max_length=most)
    if not unpacker.eof and len(result) < most and not truncated:
        raise ValueError(f"its {method} data end too early")
    return result


@contextmanager
def _damage_named(method: str) -> Iterator[None]:
    """Replace the library's errors by a ValueError."""
    try:
        yield
    except (_library("zstd").ZstdError, RuntimeError) as error:
        raise ValueError(f"its {method} data are damaged ({error})") from error


def decompress_file(path: Path, target: Path, method: str) -> None:
    """Unpack a file, up to where it is truncated, unless this would fill the disk.

    Raises ValueError if it cannot be unpacked, or is too large.
    """
    most = _MOST_RATIO * path.stat().st_size
    room = shutil.disk_usage(target.parent).free - _LEFT_FREE
    size = 0
    # The unpacked part of a truncated file is truncated, too, and its reader reports that.
    with _damage_named(method), suppress(EOFError), target.open("wb") as file, _library(method).open(path) as packed:
        while piece := packed.read(PIECE):
            size += len(piece)
            if size > most:
                raise ValueError(f"it unpacks to more than {_MOST_RATIO} times its size")
            if size > room:
                raise ValueError(f"{target.parent} has no room to unpack it; set TMPDIR to another folder")
            file.write(piece)
