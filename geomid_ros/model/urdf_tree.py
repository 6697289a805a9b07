"""Tree of a URDF's links and joints, read without meshes, and checked before pinocchio reads it."""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, tostring

import numpy as np
import pinocchio as pin
from defusedxml.common import DefusedXmlException, DTDForbidden
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

MOST_URDF_BYTES = 5_000_000
"""Size limit of a robot description."""

_MAX_NESTING = 64
_MAX_ELEMENTS = 200_000
_MAX_LINKS = 1000
LARGEST_NUMBER = 1e50
"""Bound of numbers in files: the product of three still fits a float."""
_MAX_AXES = 128  # pinocchio's memory grows with their cube
# Python's float() would also accept 1_000 and digits of other scripts.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_OF_RIGID_BODIES = {"link": ("inertial",), "joint": ("parent", "child", "origin", "axis", "limit")}
_OF_THINGS = ("visual", "collision", "inertial")
_OTHER_FORMATS = {
    "sdf": ": an SDF model. Give the URDF or xacro that it was made from; 'gz sdf -p' converts only from URDF to SDF",
    "mujoco": ": an MJCF model. Give the robot's URDF; 'geomid export --for mujoco' writes results into an MJCF model",
}
AXES = {"fixed": 0, "revolute": 1, "continuous": 1, "prismatic": 1, "planar": 3, "floating": 6}
"""Number of axes by the type of a joint."""


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A ``<joint>`` at zero: ``position (3,)`` [m] and ``rotation (3, 3)`` of its child link in the parent's frame, its
    unit ``axis (3,)`` in the child's, its range [rad or m] and its effort limit [N m or N], infinite if there is none;
    ``mimic``: the joint that moves it, with the factor on its position and what is added, if there is one."""

    name: str
    type: str
    parent: str
    child: str
    position: FloatArray
    rotation: FloatArray
    axis: FloatArray
    lower: float
    upper: float
    effort: float
    mimic: tuple[str, float, float] | None


@dataclass(frozen=True)
class UrdfTree:
    """Tree of links and joints.

    Attributes:
        links, joints: In the file's order.
        root: Root link.
        inertials: Parameters ``(10,)`` of the links with a mass, in pinocchio's order about the link frame's origin.
        physical_links: Links with a shape or an <inertial>; others may be mere frames.
    """

    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    root: str
    inertials: dict[str, FloatArray]
    physical_links: frozenset[str]

    def children(self, link: str) -> list[UrdfJoint]:
        """Return the child joints of ``link``."""
        return self._children.get(link, [])

    def subtree(self, link: str) -> list[str]:
        """Return ``link`` and all links distal to it, each listed after its parent."""
        links = [link]
        for member in links:
            links += [joint.child for joint in self.children(member)]
        return links

    def joints_above(self, link: str) -> list[UrdfJoint]:
        """Return the joints between ``link`` and the root, nearest first."""
        joints = []
        while link in self._joint_of:
            joints.append(self._joint_of[link])
            link = joints[-1].parent
        return joints

    @cached_property
    def _children(self) -> dict[str, list[UrdfJoint]]:
        children: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints:
            children.setdefault(joint.parent, []).append(joint)
        return children

    @cached_property
    def _joint_of(self) -> dict[str, UrdfJoint]:
        return {joint.child: joint for joint in self.joints}


def parse(text: str, source: str) -> UrdfTree:
    """Read a URDF's tree. Raises InputError naming ``source`` and the element if it is not usable."""
    return tree(read_xml(text, source), source)


def tree(robot: Element, source: str) -> UrdfTree:
    """Read the tree of a ``<robot>`` element, with the errors of :func:`parse`."""
    for kind in ("link", "joint"):
        if (count := len(robot.findall(kind))) > _MAX_LINKS:
            raise InputError(f"{source}: {count} {kind}s, more than the maximum of {_MAX_LINKS}")
    links = tuple(_name(element, source) for element in robot.findall("link"))
    joints = tuple(_joint(element, source) for element in robot.findall("joint"))
    axes = sum(AXES[joint.type] for joint in joints)
    if axes > _MAX_AXES:
        raise InputError(f"{source}: joints of {axes} axes, more than the maximum of {_MAX_AXES}")
    _refuse_duplicates(links, "link", source)
    _refuse_duplicates([joint.name for joint in joints], "joint", source)
    inertials = {link.get("name", ""): inertial_parameters(link, source) for link in robot.findall("link")}
    massive = {name: parameters for name, parameters in inertials.items() if parameters is not None}
    things = [link.get("name", "") for link in robot.findall("link") if any(child.tag in _OF_THINGS for child in link)]
    return UrdfTree(links, joints, _root(links, joints, source), massive, frozenset(things))


def masters(tree: UrdfTree, source: str) -> dict[str, tuple[str, float, float]]:
    """Return the final master of each mimic joint, with the overall factor and offset; without joints whose master does
    not exist. Raises InputError if one mimics itself."""
    by_name = {joint.name: joint for joint in tree.joints}
    found = {}
    for first in (joint for joint in tree.joints if joint.type != "fixed"):
        joint, factor, offset = first, 1.0, 0.0
        for _ in tree.joints:
            if joint.mimic is None or joint.mimic[0] not in by_name:
                break
            master, by, added = joint.mimic
            factor, offset, joint = factor * by, offset + factor * added, by_name[master]
        else:
            raise InputError(f"{source}: joint '{first.name}' mimics itself")
        if joint is not first:
            found[first.name] = joint.name, factor, offset
    return found


def read_xml(text: str, source: str) -> Element:
    """Return the ``<robot>`` element of a URDF. Raises InputError naming ``source``."""
    if len(text.encode(errors="replace")) > MOST_URDF_BYTES:
        raise InputError(f"{source}: larger than {MOST_URDF_BYTES // 1_000_000} MB, not a robot description")
    try:
        parser = DefusedXMLParser(target=_Builder(), forbid_dtd=True)
        parser.feed(text)
        robot: Element = parser.close()
    except (ParseError, DefusedXmlException, ValueError) as error:
        if "<xacro:" in text:
            raise _is_xacro(source) from error
        reason = f"it has a <!DOCTYPE {error.name}>" if isinstance(error, DTDForbidden) else error
        raise InputError(f"{source}: not a URDF, its XML cannot be read ({reason})") from error
    if robot.tag != "robot":
        hint = _OTHER_FORMATS.get(robot.tag, "")
        raise InputError(f"{source}: not a URDF, its root element is <{robot.tag}> instead of <robot>{hint}")
    if any("ros.org/wiki/xacro}" in element.tag for element in robot.iter()):
        raise _is_xacro(source)
    if not robot.get("name"):
        raise InputError(f"{source}: its <robot> has no name")
    return robot


def _is_xacro(source: str) -> InputError:
    command = f"xacro {shlex.quote(source)} > robot.urdf"
    return InputError(f"{source}: a xacro file; convert it with: {command}")


class _Builder(TreeBuilder):
    """Refuse too many or too deeply nested elements (ValueError)."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._count = 0

    def start(self, tag: str, attrs: dict[Any, Any], /) -> Element:
        self._depth += 1
        self._count += 1
        if self._depth > _MAX_NESTING:
            raise ValueError(f"elements are nested more than {_MAX_NESTING} deep")
        if self._count > _MAX_ELEMENTS:
            raise ValueError(f"more than {_MAX_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Element:
        self._depth -= 1
        return super().end(tag)


def without_shapes(text: str, source: str) -> str:
    """Return the URDF with rigid-body elements only, so that its reader opens no mesh and fails at no colour."""
    robot = read_xml(text, source)
    pruned = Element("robot", name=robot.get("name", ""))
    for child in robot:
        if child.tag in _OF_RIGID_BODIES:
            copy = SubElement(pruned, child.tag, child.attrib)
            copy.extend(grandchild for grandchild in child if grandchild.tag in _OF_RIGID_BODIES[child.tag])
    return tostring(pruned, encoding="unicode")


def _root(links: tuple[str, ...], joints: tuple[UrdfJoint, ...], source: str) -> str:
    """Return the root link. Refuse joints that do not form one tree (InputError)."""
    moved_by: dict[str, str] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(f"{source}: joint '{joint.name}' names the link '{link}', which does not exist")
        if joint.child in moved_by:
            both = f"'{moved_by[joint.child]}' and '{joint.name}'"
            raise InputError(f"{source}: link '{joint.child}' is the child of two joints, {both}; a URDF is a tree")
        moved_by[joint.child] = joint.name
    roots = [link for link in links if link not in moved_by]
    if len(roots) != 1:
        raise InputError(f"{source}: expected one root link, found {len(roots)}: {', '.join(roots) or 'none'}")
    reached = list(roots)
    for link in reached:
        reached += [joint.child for joint in joints if joint.parent == link]
    if looping := [link for link in links if link not in reached]:
        raise InputError(
            f"{source}: link '{looping[0]}' is in a loop of joints and not connected to the root '{roots[0]}'"
        )
    return roots[0]


def _name(element: Element, source: str) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{source}: a <{element.tag}> has no name")
    return name


def _joint(element: Element, source: str) -> UrdfJoint:
    name = _name(element, source)
    where = f"{source}: joint '{name}'"
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise InputError(f"{where} lacks a parent or a child link")
    kind = element.get("type", "")
    if kind not in AXES:
        raise InputError(f"{where} is of the unknown type '{kind}'. Valid: {', '.join(AXES)}")
    position, rotation = origin_of(element, where)
    axis = np.array(read_numbers(element, "axis", ("xyz",), [1.0, 0.0, 0.0], where))
    if kind != "fixed" and not np.any(axis):
        raise InputError(f"{where}: its <axis> has no direction")
    has_range = kind in ("revolute", "prismatic")
    if has_range or element.find("limit") is not None:
        read_numbers(element, "limit", ("effort", "velocity"), None, where)
    lower, upper, effort = (_optional(element, "limit", key, 0.0, where) for key in ("lower", "upper", "effort"))
    return UrdfJoint(
        name,
        kind,
        parent=parent.get("link", ""),
        child=child.get("link", ""),
        position=position,
        rotation=rotation,
        axis=axis / np.linalg.norm(axis) if np.any(axis) else axis,
        lower=lower if has_range else -math.inf,
        upper=upper if has_range else math.inf,
        effort=effort if effort > 0.0 else math.inf,
        mimic=_mimic(element, where),
    )


def _mimic(element: Element, where: str) -> tuple[str, float, float] | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    factor, offset = (
        _optional(element, "mimic", key, default, where) for key, default in (("multiplier", 1.0), ("offset", 0.0))
    )
    return mimic.get("joint", ""), factor, offset


def _optional(parent: Element, tag: str, key: str, default: float, where: str) -> float:
    return read_numbers(parent, tag, (key,), [default], where)[0]


def _refuse_duplicates(names: Iterable[str], kind: str, source: str) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"{source}: two {kind}s are named '{name}'")


def inertial_parameters(link: Element, source: str) -> FloatArray | None:
    """Read parameters ``(10,)`` of a link's <inertial> in the link's frame; None without one or with zero mass."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    where = f"{source}: link '{link.get('name')}'"
    if len(link.findall("inertial")) > 1:
        raise InputError(f"{where} has more than one <inertial>")
    (mass,) = read_numbers(inertial, "mass", ("value",), None, where)
    entries = read_numbers(inertial, "inertia", pseudo_inertia.INERTIA_NAMES, None, where)
    centre, axes = origin_of(inertial, where)
    if mass == 0.0:
        return None
    central = axes @ pseudo_inertia.inertia_matrix(np.array(entries)) @ axes.T
    return pseudo_inertia.assemble(np.array(mass), centre, central)


def origin_of(element: Element, where: str) -> tuple[FloatArray, FloatArray]:
    """Read position ``(3,)`` [m] and axes ``(3, 3)`` of an ``<origin>``. Raises InputError starting with ``where``."""
    position, angles = (read_numbers(element, "origin", (key,), [0.0] * 3, where) for key in ("xyz", "rpy"))
    return np.array(position), np.array(pin.rpy.rpyToMatrix(*angles))


def read_numbers(
    parent: Element, tag: str, keys: tuple[str, ...], default: list[float] | None, where: str
) -> list[float]:
    """Read finite numbers from attributes of a child element; ``default`` if absent (InputError if that is None)."""
    element = parent.find(tag)
    texts = [element.get(key) for key in keys] if element is not None else [None]
    if default is not None and texts == [None]:
        return default
    expected = len(default) if default is not None else len(keys)
    parts = [part for text in texts for part in (text or "").split()]
    numbers = [float(part) for part in parts] if all(map(_NUMBER.fullmatch, parts)) else []
    if len(numbers) != expected or not np.all(np.abs(numbers) < LARGEST_NUMBER):
        given = (f"no {key}" if text is None else f'{key}="{text}"' for key, text in zip(keys, texts, strict=False))
        problem = "is absent" if element is None else f"has {', '.join(given)}"
        raise InputError(f"{where}: its <{tag}> {problem}; expected {expected} finite numbers as {', '.join(keys)}")
    return numbers
