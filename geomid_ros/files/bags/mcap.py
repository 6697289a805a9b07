"""MCAP files (https://mcap.dev/spec): scanned once when opened, and then read part by part.

The index at the end is not used, as it may be wrong or missing. Every checksum that is present is checked: of chunks,
of the data section and of the summary. The number of messages is compared with the summary's. Of a truncated file all
intact messages are read, even those of an incomplete last chunk.
"""

from __future__ import annotations

import contextlib
import heapq
import math
import struct
import sys
from binascii import crc32
from collections import Counter
from collections.abc import Collection, Iterator
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple, TypeVar

from geomid_ros.errors import InputError, refusing
from geomid_ros.files.bags.storage import (
    PIECE,
    FaultError,
    RawMessage,
    Storage,
    TruncatedFileError,
    decompress,
    decompress_truncated,
)
from geomid_ros.files.disk import MOST_BYTES

_MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # kind, length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, times of recording and of publishing
_CHUNK_HEAD = struct.Struct("<QQQI")  # times of the first and last message, size of the unpacked data, its checksum
T = TypeVar("T")
_TOO_SHORT = "a record ends before its last field"
_TOO_MUCH = "its chunks are too large, or overlap too much in time; 'mcap sort' may help"


_Kind = IntEnum(
    "_Kind",
    "HEADER FOOTER SCHEMA CHANNEL MESSAGE CHUNK MESSAGE_INDEX CHUNK_INDEX ATTACHMENT ATTACHMENT_INDEX STATISTICS "
    "METADATA METADATA_INDEX SUMMARY_OFFSET DATA_END",
)
"""Kinds of records, from 1 on in the order of the specification."""
_PRIVATE = 0x80  # bit in the kinds of other programs' records


class _RecordSpan(NamedTuple):
    """The record of a chunk, or consecutive records of messages: their beginning and end, earliest recording time, and
    channels."""

    begin: int
    end: int
    chunk: bool
    first: float
    channels: frozenset[int]


class McapFile(Storage):
    """An open MCAP file; a file that is only truncated is read."""

    recovery_hint = "'mcap recover' may save it"

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._counted: Counter[int] = Counter()
        self._last = 0
        self._spans: list[_RecordSpan] = []
        self._file = path.open("rb")
        super().__init__(path)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _whole(self) -> tuple[int, int]:
        return self._counted.total(), self._last

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield everything on ``topics`` in the order of recording."""
        wanted = {channel: pair for channel, pair in self._channels.items() if pair[0] in topics}
        pending: list[tuple[int, int, int, bytes]] = []
        memory = serial = 0
        for span in sorted(self._spans, key=lambda span: span.first):
            if wanted.keys().isdisjoint(span.channels):
                continue
            while pending and pending[0][0] < span.first:
                memory -= _memory(pending[0])
                yield self._raw_message(heapq.heappop(pending))
            for channel, time, data in self._read(span):
                if channel in wanted:
                    heapq.heappush(pending, entry := (time, serial, channel, bytes(data)))
                    memory += _memory(entry)
                    serial += 1
                if memory > MOST_BYTES:
                    raise InputError(f"{self._path}: {_TOO_MUCH}")
        while pending:
            yield self._raw_message(heapq.heappop(pending))

    def _raw_message(self, entry: tuple[int, int, int, bytes]) -> RawMessage:
        time, _, channel, data = entry
        return RawMessage(self._channels[channel][0], time, self._channels[channel][1], data)

    def _read(self, span: _RecordSpan) -> Iterator[tuple[int, int, memoryview]]:
        """Yield channel, time and bytes of each message in a span that was examined before."""
        with refusing(f"{self._path}: has changed since it was opened", FaultError, OSError, ValueError, struct.error):
            for kind, record in self._contents(span.begin, span.end, span.chunk):
                if kind == _Kind.MESSAGE:
                    channel, _, time, _ = _MESSAGE_HEAD.unpack_from(record)
                    yield channel, time, record[_MESSAGE_HEAD.size :]

    def _examine(self) -> None:
        try:
            self._scan()
        finally:
            self.counts = dict.fromkeys(self._channels.values(), 0)
            for channel, count in self._counted.items():
                self.counts[self._channels[channel]] += count
            first = min((span.first for span in self._spans), default=math.inf)
            self.start = int(first) if math.isfinite(first) else None

    def _scan(self) -> None:
        first = self._bytes(0, len(_MAGIC))
        if not _MAGIC.startswith(first):
            raise FaultError("it does not begin with an MCAP header", 0)
        if first != _MAGIC:
            raise TruncatedFileError("the file is empty" if not first else "the file ends in its first bytes", 0)
        data_end = 0
        for kind, begin, end in self._walk():
            if data_end:
                if kind == _Kind.STATISTICS and (count := self._number(begin + _RECORD.size, 8)) != self._whole()[0]:
                    raise FaultError(f"its statistics count {count} messages, it has {self._whole()[0]}", begin)
            elif kind == _Kind.DATA_END:
                data_end, recorded = end, self._number(begin + _RECORD.size, 4)
                self._check_sum(0, begin, recorded, "data section")
                self.has_checksums |= recorded != 0
            elif kind == _Kind.HEADER:
                self._check_profile(begin, end)
            elif kind in (_Kind.CHUNK, _Kind.SCHEMA, _Kind.CHANNEL, _Kind.MESSAGE):
                self._add(self._examined(begin, end, kind == _Kind.CHUNK))
        last = self._size - len(_MAGIC)
        if self._bytes(last, self._size) != _MAGIC or not data_end:
            raise TruncatedFileError("its end is missing", self._size)
        self._check_sum(data_end, last - 4, self._number(last - 4, 4), "summary")

    def _walk(self) -> Iterator[tuple[int, int, int]]:
        """Yield kind, offset and end of each record, up to the footer."""
        kind, begin = 0, len(_MAGIC)
        while kind != _Kind.FOOTER:
            head = self._bytes(begin, begin + _RECORD.size)
            if len(head) < _RECORD.size or not any(head):  # a power failure may leave zeros
                raise TruncatedFileError("the file ends before its footer", begin)
            kind, length = _RECORD.unpack(head)
            if not _Kind.HEADER <= kind <= _Kind.DATA_END and not kind & _PRIVATE:
                raise FaultError(f"a record of the unknown kind {kind}", begin)
            end = begin + _RECORD.size + length
            if end > self._size:
                if kind & _PRIVATE or length > MOST_BYTES:
                    raise FaultError(f"a record of {length} bytes, more than there are", begin)
                if kind == _Kind.CHUNK:
                    with contextlib.suppress(FaultError):  # it is kept as far as it can be read
                        self._add(self._examined(begin, self._size, True))
                available = self._size - begin - _RECORD.size
                raise TruncatedFileError(f"a record of {length} bytes, of which {available} are there", begin)
            yield kind, begin, end
            begin = end

    def _bytes(self, begin: int, end: int) -> bytes:
        self._file.seek(begin)
        return self._file.read(end - begin)

    def _contents(self, begin: int, end: int, chunk: bool) -> Iterator[tuple[int, memoryview]]:
        """Records of a span; of a truncated chunk, the intact ones.

        Raises FaultError, ValueError and struct.error.
        """
        if end - begin > MOST_BYTES:
            raise FaultError(f"a record of {end - begin} bytes, more than {MOST_BYTES}", begin)
        data = memoryview(self._bytes(begin, end))
        if not chunk:
            self.has_checksums = False  # until the checksum of the data section is verified
            return _records(data)
        content, checked, truncated = _chunk_data(data[_RECORD.size :], end == self._size)
        self.has_checksums &= checked
        return _records(memoryview(content), truncated)

    def _examined(self, begin: int, end: int, chunk: bool) -> _RecordSpan:
        first, last, counted = math.inf, self._last, Counter[int]()
        try:
            for kind, record in self._contents(begin, end, chunk):
                if kind == _Kind.MESSAGE:
                    channel, _, time, _ = _MESSAGE_HEAD.unpack_from(record)
                    if channel not in self._channels:
                        raise ValueError(f"a message of channel {channel}, which was not declared")  # noqa: TRY301
                    counted[channel] += 1
                    first, last = min(first, time), max(last, time)
                elif kind == _Kind.SCHEMA:
                    (schema,) = struct.unpack_from("<H", record)
                    _set_once(self._schemas, schema, _text(record, 2)[0], "schema")
                elif kind == _Kind.CHANNEL:
                    self._take_channel(record)
        except (ValueError, struct.error) as error:
            raise FaultError(str(error), begin) from error
        self._last = last
        self._counted += counted
        return _RecordSpan(begin, end, chunk, first, frozenset(counted))

    def _add(self, span: _RecordSpan) -> None:
        """Append a span; consecutive records outside chunks become one span."""
        last = self._spans[-1] if self._spans else None
        if last and not last.chunk and not span.chunk and last.end == span.begin and span.end - last.begin < PIECE:
            channels = last.channels | span.channels
            self._spans[-1] = _RecordSpan(last.begin, span.end, False, min(last.first, span.first), channels)
        elif len(self._spans) * _memory(span) > MOST_BYTES:
            raise FaultError(f"more than {len(self._spans)} chunks", span.begin)
        else:
            self._spans.append(span)

    def _take_channel(self, record: memoryview) -> None:
        channel, schema = struct.unpack_from("<HH", record)
        topic, end = _text(record, 4)
        encoding, _ = _text(record, end)
        kind = self._schemas.get(schema, "unknown")
        _set_once(self._channels, channel, (topic, kind if encoding == "cdr" else f"{kind} in {encoding}"), "channel")

    def _check_profile(self, begin: int, end: int) -> None:
        try:
            profile, _ = _text(memoryview(self._bytes(begin + _RECORD.size, min(end, begin + PIECE))), 0)
        except (ValueError, struct.error) as error:
            raise FaultError(f"its header, {error}", begin) from error
        if profile != "ros2":
            raise FaultError(f"its profile is {profile[:20]!r}, expected 'ros2'", begin)

    def _number(self, begin: int, size: int) -> int:
        """Unsigned integer of ``size`` bytes at an offset."""
        return int.from_bytes(self._bytes(begin, begin + size), "little")

    def _check_sum(self, begin: int, end: int, recorded: int, part: str) -> None:
        """Compare the checksum of a part of the file with the recorded one; zero means that none was recorded."""
        computed = 0
        for place in range(begin, end, PIECE) if recorded else ():
            computed = crc32(self._bytes(place, min(end, place + PIECE)), computed)
        if computed != recorded:
            raise FaultError(f"the checksum of its {part} is wrong", begin)


def _memory(message: tuple[object, ...]) -> int:
    """Memory of a pending message [bytes]."""
    return sys.getsizeof(message) + sum(map(sys.getsizeof, message))


def _set_once(table: dict[int, T], key: int, value: T, kind: str) -> None:
    if table.setdefault(key, value) != value:
        raise ValueError(f"{kind} {key} is declared twice, with different content")


def _text(record: memoryview, begin: int) -> tuple[str, int]:
    """Text that begins at an offset of a record, and the offset of its end. Raises ValueError or struct.error if the
    record ends too early."""
    (length,) = struct.unpack_from("<I", record, begin)
    start, end = begin + 4, begin + 4 + length
    if end > len(record):
        raise ValueError(_TOO_SHORT)
    return str(record[start:end], "utf-8"), end


def _chunk_data(record: memoryview, last: bool) -> tuple[bytes | memoryview, bool, bool]:
    """Data of a chunk; True if its checksum was verified; True if it is truncated, as only the ``last`` chunk may be.

    Raises ValueError or struct.error.
    """
    _, _, size, recorded = _CHUNK_HEAD.unpack_from(record)
    method, end = _text(record, _CHUNK_HEAD.size)
    (length,) = struct.unpack_from("<Q", record, end)
    packed = record[end + 8 :]
    if length > len(packed):
        if last:
            return decompress_truncated(packed, method, size), False, True
        raise ValueError(_TOO_SHORT)
    data = decompress(packed[:length], method, size)
    if recorded and crc32(data) != recorded:
        raise ValueError("the checksum of a chunk is wrong")
    return data, recorded != 0, False


def _records(data: memoryview, truncated: bool = False) -> Iterator[tuple[int, memoryview]]:
    """Yield kind and content of each record; of ``truncated`` data, of the intact ones.

    Raises ValueError or struct.error if other data end too early.
    """
    begin = 0
    while begin < len(data):
        if truncated and len(data) - begin < _RECORD.size:
            return
        kind, length = _RECORD.unpack_from(data, begin)
        begin += _RECORD.size
        if length > len(data) - begin:
            if truncated:
                return
            raise ValueError("a record is longer than its container")
        yield kind, data[begin : begin + length]
        begin += length
