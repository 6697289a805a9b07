"""The URDF's tree of links and joints, read without meshes, and checked before pinocchio sees it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException
from scipy.spatial.transform import Rotation

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

_MAX_BYTES = 5_000_000


@dataclass(frozen=True)
class UrdfJoint:
    """One ``<joint>``: its name, type, parent and child links."""

    name: str
    type: str
    parent: str
    child: str


@dataclass(frozen=True)
class UrdfTree:
    """Link names and joints in the file's order, the root link, and the inertial parameters ``(10,)`` of the links that
    have a mass, in pinocchio's order about the link frame's origin."""

    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    root: str
    inertials: dict[str, FloatArray]

    def children(self, link: str) -> list[UrdfJoint]:
        """The joints that leave ``link``."""
        return [joint for joint in self.joints if joint.parent == link]


def parse(text: str, source: str) -> UrdfTree:
    """Read a URDF's tree. Raises InputError naming ``source`` and the element when it is not usable."""
    if len(text.encode()) > _MAX_BYTES:
        raise InputError(f"{source}: larger than {_MAX_BYTES // 1_000_000} MB, not a robot description")
    try:
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, DefusedXmlException, ValueError) as error:
        raise InputError(f"{source}: not a URDF, its XML cannot be read ({error})") from error
    if robot.tag != "robot":
        raise InputError(f"{source}: not a URDF, its root element is <{robot.tag}> instead of <robot>")
    links = tuple(_name(element, source) for element in robot.findall("link"))
    joints = tuple(_joint(element, source) for element in robot.findall("joint"))
    _refuse_duplicates(links, "link", source)
    _refuse_duplicates([joint.name for joint in joints], "joint", source)
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(f"{source}: joint '{joint.name}' names the link '{link}', which does not exist")
    inertials = {link.get("name", ""): _inertial(link, source) for link in robot.findall("link")}
    roots = [link for link in links if link not in {joint.child for joint in joints}]
    if len(roots) != 1:
        raise InputError(f"{source}: expected one root link, found {len(roots)}: {', '.join(roots) or 'none'}")
    massive = {name: parameters for name, parameters in inertials.items() if parameters is not None}
    return UrdfTree(links, joints, roots[0], massive)


def _name(element: Element, source: str) -> str:
    name = element.get("name")
    if not name:
        raise InputError(f"{source}: a <{element.tag}> has no name")
    return name


def _joint(element: Element, source: str) -> UrdfJoint:
    name = _name(element, source)
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise InputError(f"{source}: joint '{name}' lacks a parent or a child link")
    return UrdfJoint(name, element.get("type", ""), parent.get("link", ""), child.get("link", ""))


def _refuse_duplicates(names: Iterable[str], kind: str, source: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{source}: two {kind}s are named '{name}'")
        seen.add(name)


def _inertial(link: Element, source: str) -> FloatArray | None:
    """Parameters ``(10,)`` of a link's <inertial> in the link's frame; None without one or without a mass."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    where = f"{source}: link '{link.get('name')}'"
    (mass,) = _numbers(inertial.find("mass"), ("value",), None, where)
    xx, xy, xz, yy, yz, zz = _numbers(inertial.find("inertia"), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), None, where)
    if mass == 0.0:
        return None
    centre = _numbers(inertial.find("origin"), ("xyz",), [0.0, 0.0, 0.0], where)
    rotation = Rotation.from_euler("xyz", _numbers(inertial.find("origin"), ("rpy",), [0.0, 0.0, 0.0], where))
    axes = rotation.as_matrix()
    central = axes @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes.T
    return pseudo_inertia.assemble(np.array(mass), np.array(centre), central)


def _numbers(element: Element | None, keys: tuple[str, ...], default: list[float] | None, where: str) -> list[float]:
    """The finite numbers of an element's attributes; ``default`` if it or they are absent, an error if that is None."""
    texts = [element.get(key) for key in keys] if element is not None else [None]
    if default is not None and texts == [None]:
        return default
    expected = len(default) if default is not None else len(keys)
    try:
        numbers = [float(part) for text in texts for part in (text or "").split()]
    except ValueError:
        numbers = []
    if len(numbers) != expected or not np.all(np.isfinite(numbers)):
        shown = "nothing" if element is None else ", ".join(f'{key}="{element.get(key)}"' for key in keys)
        raise InputError(f"{where}: its <inertial> has {shown}, expected {expected} finite numbers for {', '.join(keys)}")
    return numbers
