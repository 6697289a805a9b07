"""Where elements stand in the bytes of a URDF, so that one of them can be changed and nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias
from xml.parsers import expat

Edit: TypeAlias = tuple[int, int, bytes]
"""Offsets of the first byte to be replaced and behind the last, and what comes in their place."""


@dataclass
class Span:
    """Where the first tag of an element ``kind`` and its first child of the kind that was asked for stand: offsets of
    the first byte and behind the last."""

    kind: str
    tag: tuple[int, int]
    child: tuple[int, int] | None = None


def spans(data: bytes, kind: str, child: str) -> Mapping[str, Span]:
    """Spans of the elements ``kind`` directly below <robot>, by name, and of their ``child`` elements."""
    found: dict[str, Span] = {}
    path: list[str] = []
    current: list[Span] = []
    child_start = 0
    parser = expat.ParserCreate("utf-8")  # whatever the XML declaration says: the text was decoded before

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal child_start
        path.append(tag)
        if path == ["robot", kind]:
            current[:] = [Span(kind, (parser.CurrentByteIndex, end_of_tag(data, parser.CurrentByteIndex)))]
            found[attributes["name"]] = current[0]
        elif path == ["robot", kind, child]:
            child_start = parser.CurrentByteIndex

    def end(_tag: str) -> None:
        if path == ["robot", kind, child] and current[0].child is None:
            current[0].child = (child_start, end_of_tag(data, parser.CurrentByteIndex))
        path.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(data, True)
    return found


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """``data`` after edits that do not overlap."""
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return data


def insertion(data: bytes, span: Span, child: bytes) -> Edit:
    """The edit that puts ``child`` in the place of the element's own, or at its beginning where it has none."""
    if span.child:
        return (*span.child, child)
    start, end = span.tag
    if data[:end].endswith(b"/>"):
        return start, end, data[start : end - 2].rstrip() + b">\n    " + child + f"\n  </{span.kind}>".encode()
    return end, end, b"\n    " + child


_QUOTED = re.compile(rb"""[^>"']+|"[^"]*"|'[^']*'""")


def end_of_tag(data: bytes, start: int) -> int:
    """Behind the tag that begins at ``start``; in quotes, a ``>`` ends nothing."""
    end = start
    while part := _QUOTED.match(data, end):
        end = part.end()
    return end + 1
