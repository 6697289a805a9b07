"""Small changes of valid inputs."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from random import Random

_EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1, 2**40, 1 << 27)
_LONGEST = 64  # bytes of a block, mostly
_LONGEST_TEXT = 6_000_000  # characters: a little more than is read of any file
NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "1e999", "0", "-0.0", "-1", "1", "3.14", "1e50", "1e49", "1e10",
    "1e-10", "", " ", "1 2", "0x10", "1_0", "٣", "9" * 400, "1e", "+", "--1", "true", "0 0 0", "1 0 0", "nan 0 0",
)  # fmt: skip
_NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def changed_bytes(data: bytes, random: Random, others: Sequence[bytes] = ()) -> bytes:
    """``data`` with one to four changes; blocks of ``others`` may come in."""
    result = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        change = random.choice(_CHANGES)
        change(result, random, random.choice(others) if others else data)
    return bytes(result)


def changed_text(text: str, random: Random, snippets: Sequence[str]) -> str:
    """``text`` with one to four changes of numbers, words, lines; ``snippets`` may come in."""
    for _ in range(random.choice((1, 1, 2, 4))):
        text = random.choice(_TEXT_CHANGES)(text, random, snippets)[:_LONGEST_TEXT]
    return text


def _block(data: bytearray, random: Random) -> tuple[int, int]:
    begin = random.randrange(len(data) + 1)
    longest = _LONGEST if random.random() < 0.8 else len(data)
    return begin, min(len(data), begin + random.randint(1, max(1, longest)))


def _flip(data: bytearray, random: Random, _: bytes) -> None:
    if data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _put_edge(data: bytearray, random: Random, _: bytes) -> None:
    form = random.choice("BHIQ")
    size = struct.calcsize(form)
    if len(data) >= size:
        value = random.choice(_EDGES) + random.choice((0, 0, -1, 1))
        place = random.randrange(len(data) - size + 1)
        data[place : place + size] = struct.pack("<" + form, value % 256**size)


def _delete(data: bytearray, random: Random, _: bytes) -> None:
    begin, end = _block(data, random)
    del data[begin:end]


def _repeat(data: bytearray, random: Random, _: bytes) -> None:
    begin, end = _block(data, random)
    place = random.randrange(len(data) + 1)
    data[place:place] = bytes(data[begin:end]) * random.choice((1, 1, 2, 10))


def _fill(data: bytearray, random: Random, _: bytes) -> None:
    begin, end = _block(data, random)
    data[begin:end] = bytes([random.choice((0, 0, 0xFF, 0x41))]) * (end - begin)


def _scramble(data: bytearray, random: Random, _: bytes) -> None:
    begin, end = _block(data, random)
    data[begin:end] = random.randbytes(end - begin)


def _cut(data: bytearray, random: Random, _: bytes) -> None:
    del data[random.randrange(len(data) + 1) :]


def _splice(data: bytearray, random: Random, other: bytes) -> None:
    begin, end = _block(data, random)
    source, stop = _block(bytearray(other), random)
    data[begin:end] = other[source:stop]


_CHANGES: tuple[Callable[[bytearray, Random, bytes], None], ...] = (
    _flip, _flip, _flip, _put_edge, _put_edge, _delete, _repeat, _fill, _scramble, _cut, _splice,
)  # fmt: skip


def _change_number(text: str, random: Random, _: Sequence[str]) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    number = random.choice(found)
    return text[: number.start()] + random.choice(NUMBERS) + text[number.end() :]


def _change_word(text: str, random: Random, _: Sequence[str]) -> str:
    words = re.findall(r"\w+", text)
    if not words:
        return text
    old, new = random.choice(words), random.choice(words)
    return re.sub(rf"\b{old}\b", new, text, count=random.choice((0, 1)))


def _change_lines(text: str, random: Random, _: Sequence[str]) -> str:
    lines = text.splitlines(keepends=True)
    begin, place = random.randrange(len(lines) + 1), random.randrange(len(lines) + 1)
    block = lines[begin : begin + random.randint(1, 8)]
    if random.random() < 0.5:
        del lines[begin : begin + len(block)]
    if random.random() < 0.7:
        lines[place:place] = block * random.choice((1, 1, 2, 50))
    return "".join(lines)


def _insert(text: str, random: Random, snippets: Sequence[str]) -> str:
    place = random.randrange(len(text) + 1)
    return text[:place] + random.choice(snippets) + text[place:]


def _change_bytes(text: str, random: Random, _: Sequence[str]) -> str:
    return changed_bytes(text.encode(errors="replace"), random).decode(errors="replace")


_TEXT_CHANGES: tuple[Callable[[str, Random, Sequence[str]], str], ...] = (
    _change_number, _change_number, _change_word, _change_lines, _insert, _change_bytes,
)  # fmt: skip
