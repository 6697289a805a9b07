"""Mcap files of every form that the format allows, right down to the last checksum; also such that lie."""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import lz4.frame
from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
_PACKERS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "zstd": zstd.compress, "lz4": lz4.frame.compress}


@dataclass(frozen=True)
class Message:
    """A message of a channel: its time [ns] and bytes."""

    channel: int
    time: int
    data: bytes


@dataclass(frozen=True)
class Form:
    """How a file is written: ``chunk`` messages in each chunk, none outside of chunks when 0; how chunks are
    compressed; whether there are checksums, and a summary."""

    chunk: int = 10
    method: str = "zstd"
    checksums: bool = True
    summary: bool = True


def record(kind: int, content: bytes) -> bytes:
    """A record."""
    return struct.pack("<BQ", kind, len(content)) + content


def text(value: str) -> bytes:
    """A text with its length."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def chunk(content: bytes, method: str, checksum: bool, size: int | None = None) -> bytes:
    """A chunk's record, which may tell another ``size`` than the true one."""
    told = crc32(content) if checksum else 0
    packed = _PACKERS[method](content)
    head = struct.pack("<QQQI", 0, 2**63, len(content) if size is None else size, told)
    return record(6, head + text(method) + struct.pack("<Q", len(packed)) + packed)


def records_of(channels: Sequence[tuple[str, str]], messages: Sequence[Message]) -> tuple[bytes, list[bytes]]:
    """Records that announce ``channels`` (topic, type), and those of messages."""
    announced = b""
    for index, (topic, kind) in enumerate(channels):
        announced += record(3, struct.pack("<H", index + 1) + text(kind) + text("ros2msg") + text(""))
        announced += record(4, struct.pack("<HH", index, index + 1) + text(topic) + text("cdr") + struct.pack("<I", 0))
    heads = (struct.pack("<HIQQ", message.channel, 0, message.time, message.time) for message in messages)
    return announced, [record(5, head + message.data) for head, message in zip(heads, messages, strict=True)]


def mcap(
    channels: Sequence[tuple[str, str]],
    messages: Sequence[Message],
    form: Form,
    change: Callable[[bytes], bytes] = bytes,
) -> bytes:
    """A file; ``change`` is done to the content of each chunk, before checksums are made."""
    announced, written = records_of(channels, messages)
    data = MAGIC + record(1, text("ros2") + text("fuzz"))
    if form.chunk:
        for begin in range(0, max(1, len(written)), form.chunk):
            content = (b"" if begin else announced) + b"".join(written[begin : begin + form.chunk])
            data += chunk(change(content), form.method, form.checksums)
    else:
        data += change(announced + b"".join(written))
    data_sum = crc32(data) if form.checksums else 0
    data += record(0x0F, struct.pack("<I", data_sum))
    summary_start = len(data) if form.summary else 0
    summary = b""
    if form.summary:
        statistics = struct.pack("<QHIIIIQQI", len(messages), len(channels), len(channels), 0, 0, 1, 0, 2**63 - 1, 0)
        summary = announced + record(0x0B, statistics)
    footer = struct.pack("<BQQQ", 2, 20, summary_start, 0)
    summary_sum = crc32(summary + footer) if form.checksums else 0
    return data + summary + footer + struct.pack("<I", summary_sum) + MAGIC
