"""Decompression into memory that is bounded: a few kilobytes can be made to unpack to gigabytes."""

from __future__ import annotations

import sys
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MOST_BYTES = 1 << 27
"""Of a message or a chunk of messages; recorders make chunks of 1 or 4 MB, or of one message that is larger."""

_MOST_RATIO = 1000  # of a whole file; no recording of times and noise comes near
_PIECE = 1 << 20


def unpacked(data: bytes | memoryview, method: str, size: int) -> bytes | memoryview:
    """What was compressed with ``method`` (zstd, lz4 or empty for none), to exactly ``size`` bytes.

    Raises ValueError if it cannot be, or is too large.
    """
    if size > MOST_BYTES:
        raise ValueError(f"{size} bytes are packed in {len(data)}, more than the {MOST_BYTES} that are allowed")
    result = data if not method else _unpacked(data, method, size + 1)
    if len(result) != size:
        found = "more" if len(result) > size else len(result)
        raise ValueError(f"what should unpack to {size} bytes unpacks to {found}")
    return result


def unpacked_message(data: bytes) -> bytes:
    """A message that was compressed by itself. Raises ValueError if it cannot be unpacked, or is too large."""
    result = _unpacked(data, "zstd", MOST_BYTES + 1)
    if len(result) > MOST_BYTES:
        raise ValueError(f"a message unpacks to more than {MOST_BYTES} bytes")
    return result


def _unpacked(data: bytes | memoryview, method: str, most: int) -> bytes:
    if method not in ("zstd", "lz4"):
        raise ValueError(f"its compression is {method[:20]!r}, expected zstd, lz4 or none")
    unpacker = zstd.ZstdDecompressor() if method == "zstd" else lz4.frame.LZ4FrameDecompressor()
    try:
        result: bytes = unpacker.decompress(data, max_length=most)
    except (zstd.ZstdError, RuntimeError) as error:
        raise ValueError(f"its {method} data are damaged ({error})") from error
    if not unpacker.eof and len(result) < most:
        raise ValueError(f"its {method} data end too early")
    return result


def unpack_file(path: Path, target: Path) -> None:
    """Unpack a zstd file. Raises ValueError if it cannot be, or is too large."""
    left = _MOST_RATIO * path.stat().st_size
    try:
        with zstd.open(path, "rb") as packed, target.open("wb") as file:
            while piece := packed.read(_PIECE):
                left -= len(piece)
                if left < 0:
                    raise ValueError(f"it unpacks to more than {_MOST_RATIO} times its size")
                file.write(piece)
    except (zstd.ZstdError, EOFError) as error:
        raise ValueError(f"its zstd data are damaged ({error})") from error
