"""Reading robot descriptions, and writing identified inertias into them without touching anything else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import LinkEstimate


def read_urdf(path: Path) -> str:
    """The text of a URDF file, with the line ends it has."""
    try:
        return path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the robot description cannot be read ({error})") from error


@dataclass
class _LinkSpan:
    """Where, in the bytes of a URDF, a link's first tag and its inertial stand: offsets of the first byte and behind
    the last."""

    tag: tuple[int, int]
    inertial: tuple[int, int] | None = None


def with_identified_inertias(urdf: str, links: Sequence[LinkEstimate]) -> str:
    """``urdf`` with the inertials of the identified bodies; every other character of it is kept.

    A body's inertia goes to its moving link. The inertials of the links that are fixed to it and counted in are
    removed: their mass is in the moving link's.
    """
    data = urdf.encode()
    spans = _link_spans(data)
    edits: list[tuple[int, int, bytes]] = []
    for link in links:
        edits.append(_insertion(data, spans[link.name], _inertial(link)))
        edits += [(*inertial, b"") for name in link.merged if (inertial := spans[name].inertial)]
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return data.decode()


def _insertion(data: bytes, span: _LinkSpan, inertial: bytes) -> tuple[int, int, bytes]:
    """The edit (start, end, text) that gives a link this inertial."""
    if span.inertial:
        return (*span.inertial, inertial)
    start, end = span.tag
    if data[:end].endswith(b"/>"):
        return start, end, data[start : end - 2].rstrip() + b">\n    " + inertial + b"\n  </link>"
    return end, end, b"\n    " + inertial


def _inertial(link: LinkEstimate) -> bytes:
    centre = " ".join(f"{value:.9g}" for value in link.com)
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    inertia = " ".join(f'{key}="{link.inertia[index]:.9g}"' for key, index in entries.items())
    return (
        f'<inertial>\n      <origin xyz="{centre}" rpy="0 0 0"/>\n      <mass value="{link.mass:.9g}"/>\n'
        f"      <inertia {inertia}/>\n    </inertial>"
    ).encode()


def _link_spans(data: bytes) -> Mapping[str, _LinkSpan]:
    """Spans of the links directly below <robot>, by name."""
    spans: dict[str, _LinkSpan] = {}
    path: list[str] = []
    current: list[_LinkSpan] = []
    inertial_start = 0
    parser = expat.ParserCreate("utf-8")  # whatever the XML declaration says: the text was decoded before

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal inertial_start
        path.append(tag)
        if path == ["robot", "link"]:
            current[:] = [_LinkSpan((parser.CurrentByteIndex, _end_of_tag(data, parser.CurrentByteIndex)))]
            spans[attributes["name"]] = current[0]
        elif path == ["robot", "link", "inertial"]:
            inertial_start = parser.CurrentByteIndex

    def end(_tag: str) -> None:
        if path == ["robot", "link", "inertial"] and current[0].inertial is None:
            current[0].inertial = (inertial_start, _end_of_tag(data, parser.CurrentByteIndex))
        path.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(data, True)
    return spans


_QUOTED = re.compile(rb"""[^>"']+|"[^"]*"|'[^']*'""")


def _end_of_tag(data: bytes, start: int) -> int:
    """Behind the tag that begins at ``start``; in quotes, a ``>`` ends nothing."""
    end = start
    while part := _QUOTED.match(data, end):
        end = part.end()
    return end + 1
