"""Checksums of mcap files, which rosbags leaves out when it writes: a flipped bit would change a value unseen."""

from __future__ import annotations

import struct
import sys
from binascii import crc32
from pathlib import Path

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_MAGIC_LENGTH = 8
_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")  # kind, length
_CHUNK_HEAD = struct.Struct("<QQQII4sQ")  # first and last time, size, checksum, "zstd", packed size


def add_checksums(path: Path) -> None:
    """Write the checksums of chunks, data section and summary into a file with zstd chunks."""
    data = bytearray(path.read_bytes())
    begin, data_end, kind = _MAGIC_LENGTH, 0, 0
    while kind != _FOOTER:
        kind, length = _RECORD.unpack_from(data, begin)
        content = begin + _RECORD.size
        if kind == _CHUNK:
            packed = content + _CHUNK_HEAD.size
            struct.pack_into("<I", data, content + 24, crc32(zstd.decompress(data[packed : content + length])))
        elif kind == _DATA_END:
            struct.pack_into("<I", data, content, crc32(data[:begin]))
            data_end = content + length
        elif kind == _FOOTER:
            struct.pack_into("<I", data, content + 16, crc32(data[data_end : content + 16]))
        begin = content + length
    path.write_bytes(data)
