"""Edits of XML texts that leave every other character unchanged."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias
from xml.parsers import expat

Edit: TypeAlias = tuple[int, int, bytes]
"""Offset of the first byte to replace, offset after the last one, and the replacement."""


@dataclass
class Span:
    """Location of an element of this ``kind``: byte offsets of the start and end of its first ``tag``, and of its first
    ``child`` element of the requested kind."""

    kind: str
    tag: tuple[int, int]
    child: tuple[int, int] | None = None


def spans_of(data: bytes, above: list[str], kind: str, child: str = "", *, deeper: bool = False) -> dict[str, Span]:
    """Spans by name of the elements ``kind`` directly below the path ``above``, which begins at the root, or anywhere
    ``deeper``, and of their ``child`` elements."""
    spans: dict[str, Span] = {}
    path: list[tuple[str, Span | None]] = []
    parser = expat.ParserCreate("utf-8")  # the XML declaration is ignored, as the text was decoded before

    def start(tag: str, attributes: dict[str, str]) -> None:
        names, begin = [name for name, _ in path], parser.CurrentByteIndex
        inside = names[: len(above)] == above and (deeper or len(names) == len(above))
        span = None
        if tag == kind and inside and "name" in attributes:
            span = spans[attributes["name"]] = Span(kind, (begin, end_of_tag(data, begin)))
        elif tag == child and path and (parent := path[-1][1]) and parent.child is None:
            closed = end_of_tag(data, begin)
            parent.child = (begin, closed if data[:closed].endswith(b"/>") else begin)
        path.append((tag, span))

    def end(tag: str) -> None:
        path.pop()
        if tag == child and path and (parent := path[-1][1]) and parent.child and len(set(parent.child)) == 1:
            parent.child = (parent.child[0], end_of_tag(data, parser.CurrentByteIndex))

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(data, True)
    return spans


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Apply edits that do not overlap to ``data``."""
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return data


def insertion(data: bytes, span: Span, child: bytes) -> Edit:
    """Edit that replaces the element's child by ``child``, or inserts it at the beginning if there is none."""
    if span.child:
        return (*span.child, child)
    start, end = span.tag
    if data[:end].endswith(b"/>"):
        return start, end, data[start : end - 2].rstrip() + b">\n    " + child + f"\n  </{span.kind}>".encode()
    return end, end, b"\n    " + child


def with_attributes(tag: bytes, attributes: Mapping[str, str]) -> bytes:
    """Set these attributes in the first tag of an element; its other attributes remain."""
    for name, value in attributes.items():
        attribute = f'{name}="{value}"'.encode()
        pattern = rb"(?<=\s)" + name.encode() + rb"""\s*=\s*("[^"]*"|'[^']*')"""
        tag, count = re.subn(pattern, attribute, tag, count=1)
        if not count:
            tag = re.sub(rb"<[^\s/>]+", lambda start, attribute=attribute: start[0] + b" " + attribute, tag, count=1)  # type: ignore[misc]
    return tag


_QUOTED = re.compile(rb"""[^>"']+|"[^"]*"|'[^']*'""")


def end_of_tag(data: bytes, start: int) -> int:
    """Offset after the tag that begins at ``start``; a ``>`` in quotes does not end it."""
    end = start
    while part := _QUOTED.match(data, end):
        end = part.end()
    return end + 1
