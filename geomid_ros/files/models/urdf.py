"""Reading robot descriptions, and writing identified inertias and effects into them without touching anything else."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from xml.parsers import expat

from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effect_forms import is_body, is_sure, joint_attributes, payload_quantities
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect, values_of
from geomid_ros.model.urdf_tree import MOST_BYTES
from geomid_ros.types import FloatArray

# Mass [kg], centre of mass (3,) [m] in the link's frame, inertia (3, 3) [kg m^2] about it in the link's axes.
Inertia: TypeAlias = tuple[float, FloatArray, FloatArray]

_Edit: TypeAlias = tuple[int, int, bytes]
"""Offsets of the first byte to be replaced and behind the last, and what comes in their place."""


@dataclass
class _Span:
    """Where the first tag of an element ``kind`` and its first child of the kind that was asked for stand: offsets of
    the first byte and behind the last."""

    kind: str
    tag: tuple[int, int]
    child: tuple[int, int] | None = None


def read_urdf(path: Path) -> str:
    """The text of a URDF file, with the line ends it has. Raises InputError naming it."""
    return read_text(path, "robot description", MOST_BYTES)


def inertia_of(parameters: FloatArray) -> Inertia:
    """The inertia of a body with parameters ``(10,)``."""
    centre = pseudo_inertia.centre_of_mass(parameters)
    return float(parameters[0]), centre, pseudo_inertia.central_inertia(parameters)


def with_identified_inertias(urdf: str, links: Sequence[LinkEstimate]) -> str:
    """``urdf`` with the inertials of the identified bodies; every other character of it is kept.

    A body's inertia goes to its moving link. The inertials of the links that are fixed to it and counted in are
    removed: their mass is in the moving link's.
    """
    merged = [name for link in links for name in link.merged]
    return with_inertials(urdf, {link.name: (link.mass, link.com, link.inertia) for link in links}, merged)


def with_inertials(urdf: str, inertias: Mapping[str, Inertia], removed: Sequence[str] = ()) -> str:
    """``urdf`` with these inertials, by the link's name, and without those of the links ``removed``; every other
    character of it is kept."""
    data = urdf.encode()
    links = _spans(data, "link", "inertial")
    edits = [_insertion(data, links[name], _inertial(*inertia)) for name, inertia in inertias.items()]
    edits += [(*inertial, b"") for name in removed if (inertial := links[name].child)]
    return _edited(data, edits).decode()


def _inertial(mass: float, com: FloatArray, inertia: FloatArray) -> bytes:
    centre = " ".join(f"{value:.9g}" for value in com)
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    numbers = " ".join(f'{key}="{inertia[index]:.9g}"' for key, index in entries.items())
    return (
        f'<inertial>\n      <origin xyz="{centre}" rpy="0 0 0"/>\n      <mass value="{mass:.9g}"/>\n'
        f"      <inertia {numbers}/>\n    </inertial>"
    ).encode()


def with_effects(urdf: str, effects: Iterable[KnownEffect]) -> str:
    """``urdf`` with the effects that a URDF can say; every other character of it is kept.

    What sure effects say of a joint's ``<dynamics>`` is added up there; a payload becomes a link that is fixed to the
    one which carries it.
    """
    data = urdf.encode()
    effects = [effect for effect in effects if is_sure(effect)]
    joints, links = _spans(data, "joint", "dynamics"), _spans(data, "link", "inertial")
    edits = [_dynamics(data, joints[name], own) for name, own in joint_attributes(effects, "dynamics").items()]
    end = data.rindex(b"</robot")
    payloads = [_payload(effect, links, joints) for effect in effects if is_body(effect)]
    edits.append((end, end, b"".join(payloads)))
    return _edited(data, edits).decode()


def _dynamics(data: bytes, joint: _Span, numbers: Mapping[str, float]) -> _Edit:
    """The edit that gives a joint's <dynamics> these attributes; others that it has stay."""
    element = data[slice(*joint.child)] if joint.child else b"<dynamics/>"
    for name, value in numbers.items():
        said = f'{name}="{value:.9g}"'.encode()
        pattern = rb"(?<=\s)" + name.encode() + rb"""\s*=\s*("[^"]*"|'[^']*')"""
        element, found = re.subn(pattern, said, element, count=1)
        if not found:
            element = element.replace(b"<dynamics", b"<dynamics " + said, 1)
    return _insertion(data, joint, element)


def _payload(effect: KnownEffect, links: Mapping[str, _Span], joints: Mapping[str, _Span]) -> bytes:
    name = f"{effect.link}_payload"
    while name in links or name in joints:
        name += "_"
    payload = payload_quantities(values_of(effect))
    inertial = _inertial(payload[0], payload[1:4], pseudo_inertia.inertia_matrix(payload[4:])).decode()
    return (
        f'  <link name="{name}">\n    {inertial}\n  </link>\n  <joint name="{name}" type="fixed">\n'
        f'    <parent link="{effect.link}"/>\n    <child link="{name}"/>\n  </joint>\n'
    ).encode()


def _spans(data: bytes, kind: str, child: str) -> Mapping[str, _Span]:
    """Spans of the elements ``kind`` directly below <robot>, by name, and of their ``child`` elements."""
    found: dict[str, _Span] = {}
    path: list[str] = []
    current: list[_Span] = []
    child_start = 0
    parser = expat.ParserCreate("utf-8")  # whatever the XML declaration says: the text was decoded before

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal child_start
        path.append(tag)
        if path == ["robot", kind]:
            current[:] = [_Span(kind, (parser.CurrentByteIndex, _end_of_tag(data, parser.CurrentByteIndex)))]
            found[attributes["name"]] = current[0]
        elif path == ["robot", kind, child]:
            child_start = parser.CurrentByteIndex

    def end(_tag: str) -> None:
        if path == ["robot", kind, child] and current[0].child is None:
            current[0].child = (child_start, _end_of_tag(data, parser.CurrentByteIndex))
        path.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(data, True)
    return found


def _edited(data: bytes, edits: Iterable[_Edit]) -> bytes:
    """``data`` after edits that do not overlap."""
    for start, end, text in sorted(edits, reverse=True):
        data = data[:start] + text + data[end:]
    return data


def _insertion(data: bytes, span: _Span, child: bytes) -> _Edit:
    """The edit that puts ``child`` in the place of the element's own, or at its beginning where it has none."""
    if span.child:
        return (*span.child, child)
    start, end = span.tag
    if data[:end].endswith(b"/>"):
        return start, end, data[start : end - 2].rstrip() + b">\n    " + child + f"\n  </{span.kind}>".encode()
    return end, end, b"\n    " + child


_QUOTED = re.compile(rb"""[^>"']+|"[^"]*"|'[^']*'""")


def _end_of_tag(data: bytes, start: int) -> int:
    """Behind the tag that begins at ``start``; in quotes, a ``>`` ends nothing."""
    end = start
    while part := _QUOTED.match(data, end):
        end = part.end()
    return end + 1
