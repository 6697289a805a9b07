"""Decompression into memory that is bounded: a few kilobytes can be made to unpack to gigabytes."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

MOST_BYTES = 1 << 27
"""Of a message or a chunk of messages; recorders make chunks of 1 or 4 MB, or of one message that is larger."""

METHODS = ("zstd", "lz4")
"""Of compression."""

_MOST_RATIO = 300  # of a whole file; no recording of times and noise comes near
_LEFT_FREE = 500_000_000  # bytes of a disk that others may need
_PIECE = 1 << 16  # bytes of a file; of a torn one, less than that is lost


@cache
def _library(method: str) -> Any:
    """What unpacks ``method``, imported for the first recording: a node beside a robot has none."""
    if method == "lz4":
        import lz4.frame  # type: ignore[import-untyped] # noqa: PLC0415

        return lz4.frame
    if sys.version_info >= (3, 14):
        from compression import zstd  # noqa: PLC0415
    else:
        from backports import zstd  # noqa: PLC0415
    return zstd


def unpacked(data: bytes | memoryview, method: str, size: int) -> bytes | memoryview:
    """What was compressed with ``method`` (zstd, lz4 or empty for none), to exactly ``size`` bytes.

    Raises ValueError if it cannot be, or is too large.
    """
    if size > MOST_BYTES:
        raise ValueError(f"{size} bytes unpacked from {len(data)}, more than the maximum of {MOST_BYTES}")
    result = data if not method else _unpacked(data, method, size + 1)
    if len(result) != size:
        found = "more" if len(result) > size else len(result)
        raise ValueError(f"expected {size} unpacked bytes, found {found}")
    return result


def unpacked_part(data: bytes | memoryview, method: str, size: int) -> bytes | memoryview:
    """The beginning of what was compressed to ``data``, the end of which is missing. Raises ValueError."""
    most = min(size, MOST_BYTES)
    if not method:
        return data[:most]
    return _decompressed(_unpacker(method), data, method, most)


def unpacked_message(data: bytes, method: str) -> bytes:
    """A message that was compressed by itself. Raises ValueError if it cannot be unpacked, or is too large."""
    result = _unpacked(data, method, MOST_BYTES + 1)
    if len(result) > MOST_BYTES:
        raise ValueError(f"a message unpacks to more than {MOST_BYTES} bytes")
    return result


def _unpacked(data: bytes | memoryview, method: str, most: int) -> bytes:
    unpacker = _unpacker(method)
    result = _decompressed(unpacker, data, method, most)
    if not unpacker.eof and len(result) < most:
        raise ValueError(f"its {method} data end too early")
    return result


def _decompressed(unpacker: Any, data: bytes | memoryview, method: str, most: int) -> bytes:
    try:
        result: bytes = unpacker.decompress(data, max_length=most)
    except (_library("zstd").ZstdError, RuntimeError) as error:
        raise ValueError(f"its {method} data are damaged ({error})") from error
    return result


def _unpacker(method: str) -> Any:
    if method not in METHODS:
        raise ValueError(f"its compression is {method[:20]!r}, expected zstd, lz4 or none")
    library = _library(method)
    return library.ZstdDecompressor() if method == "zstd" else library.LZ4FrameDecompressor()


def unpack_file(path: Path, target: Path, method: str) -> None:
    """Unpack a file, up to where it is cut off, unless the disk would be full.

    Raises ValueError if it cannot be unpacked, or is too large.
    """
    most = _MOST_RATIO * path.stat().st_size
    room = shutil.disk_usage(target.parent).free - _LEFT_FREE
    size = 0
    with target.open("wb") as file:
        for piece in _pieces(path, method):
            size += len(piece)
            if size > most:
                raise ValueError(f"it unpacks to more than {_MOST_RATIO} times its size")
            if size > room:
                raise ValueError(f"{target.parent} has no room to unpack it; set TMPDIR to another folder")
            file.write(piece)


def _pieces(path: Path, method: str) -> Iterator[bytes]:
    """What a file unpacks to, up to where it is cut off. Raises ValueError."""
    try:
        with _library(method).open(path, "rb") as packed:
            while piece := packed.read(_PIECE):
                yield piece
    except EOFError:
        return  # what was unpacked has no end, either, and its reader says so
    except (_library("zstd").ZstdError, RuntimeError) as error:
        raise ValueError(f"its {method} data are damaged ({error})") from error
