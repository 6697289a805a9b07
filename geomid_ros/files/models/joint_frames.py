"""Where a URDF's joints sit, what they turn about and how far."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.model.urdf_tree import axes_of, read_numbers, read_xml
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class JointFrame:
    """A joint at zero: ``position (3,)`` [m] and ``rotation (3, 3)`` of its child link in the parent's frame, its unit
    ``axis (3,)`` in the child's, its range [rad or m] and its effort limit [N m or N], infinite where there is none."""

    name: str
    slides: bool
    parent: str
    child: str
    position: FloatArray
    rotation: FloatArray
    axis: FloatArray
    lower: float
    upper: float
    effort: float


def joint_frames(urdf: str, source: str) -> tuple[JointFrame, ...]:
    """The joints of a URDF in its order. Raises InputError naming ``source``."""
    return tuple(_joint_frame(element, source) for element in read_xml(urdf, source).findall("joint"))


def _joint_frame(element: Element, source: str) -> JointFrame:
    name, kind = element.get("name", ""), element.get("type", "")
    where = f"{source}: joint '{name}'"
    position = read_numbers(element, "origin", ("xyz",), [0.0, 0.0, 0.0], where)
    angles = read_numbers(element, "origin", ("rpy",), [0.0, 0.0, 0.0], where)
    axis = np.array(read_numbers(element, "axis", ("xyz",), [1.0, 0.0, 0.0], where))
    lower, upper, effort = -math.inf, math.inf, math.inf
    if kind in ("revolute", "prismatic"):
        limit = element.find("limit")
        lower, upper, effort = (_limit(limit, key, where) for key in ("lower", "upper", "effort"))
    return JointFrame(
        name=name,
        slides=kind == "prismatic",
        parent=element.find("parent").get("link", ""),  # type: ignore[union-attr]  # the tree was checked
        child=element.find("child").get("link", ""),  # type: ignore[union-attr]
        position=np.array(position),
        rotation=axes_of(angles),
        axis=axis / np.linalg.norm(axis) if np.any(axis) else axis,
        lower=lower,
        upper=upper,
        effort=effort if effort > 0.0 else math.inf,
    )


def _limit(limit: Element | None, key: str, where: str) -> float:
    """A number of a joint's <limit>; zero where it is absent, as URDF has it."""
    if limit is None or limit.get(key) is None:
        return 0.0
    parent = Element("joint")
    parent.append(limit)
    return read_numbers(parent, "limit", (key,), None, where)[0]
