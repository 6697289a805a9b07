"""Edits of XML texts that leave every other character as it is."""

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


def children_of(data: bytes, root: str, kind: str, child: str) -> dict[str, Span]:
    """Spans of the elements ``kind`` directly below the ``root`` of the text, by name, and of their ``child``
    elements."""
    return _spans(data, [root], kind, child, deeper=False)


def descendants_of(data: bytes, above: list[str], kind: str, child: str = "") -> dict[str, Span]:
    """The same of those anywhere below the elements ``above``, from the root on."""
    return _spans(data, above, kind, child, deeper=True)


def _spans(data: bytes, above: list[str], kind: str, child: str, *, deeper: bool) -> dict[str, Span]:
    found: dict[str, Span] = {}
    path: list[tuple[str, Span | None]] = []
    parser = expat.ParserCreate("utf-8")  # whatever the XML declaration says: the text was decoded before

    def start(tag: str, attributes: dict[str, str]) -> None:
        names, begin = [name for name, _ in path], parser.CurrentByteIndex
        inside = names[: len(above)] == above and (deeper or len(names) == len(above))
        span = None
        if tag == kind and inside and "name" in attributes:
            span = found[attributes["name"]] = Span(kind, (begin, end_of_tag(data, begin)))
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


def with_attributes(tag: bytes, attributes: Mapping[str, str]) -> bytes:
    """An element whose first tag has these attributes; others that it has stay."""
    for name, value in attributes.items():
        said = f'{name}="{value}"'.encode()
        pattern = rb"(?<=\s)" + name.encode() + rb"""\s*=\s*("[^"]*"|'[^']*')"""
        tag, found = re.subn(pattern, said, tag, count=1)
        if not found:
            tag = re.sub(rb"<[^\s/>]+", lambda start, said=said: start[0] + b" " + said, tag, count=1)  # type: ignore[misc]
    return tag


_QUOTED = re.compile(rb"""[^>"']+|"[^"]*"|'[^']*'""")


def end_of_tag(data: bytes, start: int) -> int:
    """Behind the tag that begins at ``start``; in quotes, a ``>`` ends nothing."""
    end = start
    while part := _QUOTED.match(data, end):
        end = part.end()
    return end + 1
