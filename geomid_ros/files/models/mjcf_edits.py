"""Identified bodies and joints in an MJCF of the user's own, every other character of which is kept."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

import numpy as np

from geomid_ros.files.models.mjcf import inertial_attributes
from geomid_ros.files.models.xml_edits import Edit, descendants_of, edited, insertion, with_attributes
from geomid_ros.types import FloatArray

_WORLD = ["mujoco", "worldbody"]
_NOTHING = b'<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'
_RADIANS = re.compile(r"""<compiler\b[^>]*\sangle\s*=\s*["']radian["']""")


def with_identified(
    mjcf: str,
    bodies: Mapping[str, FloatArray],
    joints: Mapping[str, Mapping[str, float]],
    emptied: Collection[str] = (),
) -> str:
    """An MJCF with what was identified.

    Args:
        mjcf: the text.
        bodies: inertial parameters ``(10,)`` of bodies by name, in their own frames.
        joints: attributes of joints by name, angles in radians.
        emptied: bodies that weigh nothing of their own, as others count them in.
    """
    data = mjcf.encode()
    places, tags = descendants_of(data, _WORLD, "body", "inertial"), descendants_of(data, _WORLD, "joint")
    edits: list[Edit] = [
        insertion(data, places[name], with_attributes(b"<inertial/>", inertial_attributes(parameters)))
        for name, parameters in bodies.items()
    ]
    edits += [insertion(data, places[name], _NOTHING) for name in emptied]
    for name, numbers in joints.items():
        start, end = tags[name].tag
        slides = re.search(rb"""\stype\s*=\s*["']slide""", data[start:end])
        turns = {} if slides or _RADIANS.search(mjcf) else {"springref": 180.0 / np.pi}
        words = {key: repr(float(value * turns.get(key, 1.0))) for key, value in sorted(numbers.items())}
        edits.append((start, end, with_attributes(data[start:end], words)))
    return edited(data, edits).decode()
