"""Inertials and joint limits from a URDF, read by the simulator itself, random perturbations of bodies, and the robots
that ship with the package.

MuJoCo reads the kinematics from the same text, stripped of everything else. The shipped robots are files without meshes
in ``robots``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from geomid_ros.errors import InputError, refusing, unknown_name
from geomid_ros.types import FloatArray, frozen

WRIST_FRAME = "wrist_ft"
"""Link with the wrench sensor on every shipped robot."""

_SHIPPED = files(__package__) / "robots"
_SUFFIX = ".urdf"
_LARGEST = 5_000_000
_MOVING = {"revolute", "continuous", "prismatic"}
_KINEMATIC = {"link": (), "joint": ("origin", "parent", "child", "axis", "limit")}
INERTIA_NAMES = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
"""URDF names of the entries of an inertia matrix, row by row."""


@dataclass(frozen=True, eq=False)
class LinkInertia:
    """A link's ``mass`` [kg], centre of mass ``com (3,)`` [m] in the link frame, and ``inertia (3, 3)`` [kg m^2].

    The inertia is about the centre of mass, in the link's axes.
    """

    name: str
    mass: float
    com: FloatArray
    inertia: FloatArray


@dataclass(frozen=True)
class UrdfLimits:
    """Limits of a moving joint: range [rad or m], speed [rad/s or m/s] and effort [N m or N]."""

    name: str
    lower: float
    upper: float
    velocity: float
    effort: float

    @property
    def centre(self) -> float:
        """Middle of the range."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half_range(self) -> float:
        """Distance from the middle of the range to either end."""
        return 0.5 * (self.upper - self.lower)


@dataclass(frozen=True)
class Edge:
    """Connection of a link to its ``parent`` link: a ``joint``, which ``moves`` or is fixed."""

    joint: str
    parent: str
    moves: bool


@dataclass(frozen=True, kw_only=True)
class Description:
    """Robot as its URDF describes it.

    Attributes:
        text: The URDF.
        kinematics: The URDF reduced to its tree of joints.
        links, root: Names of all links, and of the root.
        inertias, joints: Links with a mass, and moving joints.
        edges: Connection of every link but the root to its parent, by link.
    """

    text: str
    kinematics: str
    links: tuple[str, ...]
    root: str
    inertias: tuple[LinkInertia, ...]
    joints: tuple[UrdfLimits, ...]
    edges: Mapping[str, Edge]

    def moved_by(self, link: str) -> str | None:
        """Nearest moving joint between a link and the root; None if no joint moves the link."""
        while link in self.edges:
            if self.edges[link].moves:
                return self.edges[link].joint
            link = self.edges[link].parent
        return None

    def child(self, joint: str) -> str:
        """Child link of a joint."""
        return next(link for link, edge in self.edges.items() if edge.joint == joint)


def read_description(text: str) -> Description:
    """Read a URDF; links without mass have no inertia."""
    robot = _parse(text)
    links = tuple(_attribute(link, "name") for link in robot.findall("link"))
    inertias = tuple(filter(None, map(_inertia, robot.findall("link"))))
    joints = tuple(_limits(joint) for joint in robot.findall("joint") if _kind(joint) in _MOVING)
    if not joints:
        raise InputError("the URDF has no moving joint; a simulation needs at least one.")
    edges = dict(_edge(joint) for joint in robot.findall("joint"))
    roots = [link for link in links if link not in edges]
    if len(roots) != 1:
        raise InputError(f"the URDF's links form {len(roots)} trees, with the roots {roots}; connect them to one.")
    return Description(
        text=text,
        kinematics=_kinematics(robot),
        links=links,
        root=roots[0],
        inertias=inertias,
        joints=joints,
        edges=edges,
    )


def _edge(joint: Element) -> tuple[str, Edge]:
    parent, child = (_attribute(_child(joint, tag), "link") for tag in ("parent", "child"))
    return child, Edge(_attribute(joint, "name"), parent, _kind(joint) in _MOVING)


def _parse(text: str) -> Element:
    if len(text) > _LARGEST:
        raise InputError(f"the URDF has {len(text)} characters; at most {_LARGEST} are read.")
    with refusing(
        "the URDF has to be well-formed XML without a document type", ElementTree.ParseError, DefusedXmlException
    ):
        robot: Element = ElementTree.fromstring(text, forbid_dtd=True)
    if robot.tag != "robot":
        raise InputError(f"expected a URDF, whose root element is <robot>; found <{robot.tag}>.")
    return robot


def _inertia(link: Element) -> LinkInertia | None:
    """Inertia of a link; None if it has no mass."""
    inertial = link.find("inertial")
    if inertial is None or (mass := _number(_child(inertial, "mass"), "value")) <= 0.0:
        return None
    origin = inertial.find("origin")
    com, rotation = (np.zeros(3), np.eye(3)) if origin is None else _placement(origin)
    element = _child(inertial, "inertia")
    inertia = np.array([[_number(element, name) for name in row] for row in INERTIA_NAMES])
    return LinkInertia(_attribute(link, "name"), mass, frozen(com), frozen(rotation @ inertia @ rotation.T))


def _placement(origin: Element) -> tuple[FloatArray, FloatArray]:
    position, angles = (np.array(_numbers(origin, key, "0 0 0", 3)) for key in ("xyz", "rpy"))
    (c_x, c_y, c_z), (s_x, s_y, s_z) = np.cos(angles), np.sin(angles)
    roll, pitch, yaw = (
        np.array([[1.0, 0.0, 0.0], [0.0, c_x, -s_x], [0.0, s_x, c_x]]),
        np.array([[c_y, 0.0, s_y], [0.0, 1.0, 0.0], [-s_y, 0.0, c_y]]),
        np.array([[c_z, -s_z, 0.0], [s_z, c_z, 0.0], [0.0, 0.0, 1.0]]),
    )
    return position, yaw @ pitch @ roll


def _limits(joint: Element) -> UrdfLimits:
    name = _attribute(joint, "name")
    limit = _child(joint, "limit")
    velocity, effort = _number(limit, "velocity"), _number(limit, "effort")
    endless = _kind(joint) == "continuous"
    lower, upper = (-math.pi, math.pi) if endless else (_number(limit, "lower", "0"), _number(limit, "upper", "0"))
    if not (velocity > 0.0 and effort > 0.0 and lower < upper):
        raise InputError(f"joint '{name}' needs limits with velocity > 0, effort > 0 and lower < upper.")
    return UrdfLimits(name, lower, upper, velocity, effort)


def _kind(joint: Element) -> str:
    kind = _attribute(joint, "type")
    if kind not in {*_MOVING, "fixed"} or joint.find("mimic") is not None:
        raise InputError(
            f"joint '{joint.get('name')}' is of type '{kind}' or mimics another one; "
            f"the simulator knows {', '.join(sorted(_MOVING))} and fixed joints."
        )
    return kind


def _kinematics(robot: Element) -> str:
    tree = Element("robot", {"name": robot.get("name", "robot")})
    for part in robot:
        if part.tag in _KINEMATIC:
            copy = SubElement(tree, part.tag, part.attrib)
            copy.extend(child for tag in _KINEMATIC[part.tag] if (child := part.find(tag)) is not None)
    return ElementTree.tostring(tree, encoding="unicode")


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        raise InputError(f"<{element.tag} name='{element.get('name', '')}'> has no <{tag}>; the simulator needs it.")
    return child


def _attribute(element: Element, key: str, default: str | None = None) -> str:
    value = element.get(key, default)
    if value is None:
        raise InputError(f"a <{element.tag}> has no attribute '{key}'.")
    return value


def _numbers(element: Element, key: str, default: str | None = None, count: int = 1) -> list[float]:
    text = _attribute(element, key, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"<{element.tag} {key}='{text}'> has to hold {count} finite number{'s' * (count > 1)}.")
    return values


def _number(element: Element, key: str, default: str | None = None) -> float:
    return _numbers(element, key, default)[0]


def perturbed(nominal: LinkInertia, size: float, rng: np.random.Generator) -> LinkInertia:
    """Perturb ``nominal`` at random by congruence of its 4x4 pseudo-inertia: ``L exp(E) L^T`` where ``P = L L^T``.

    ``E`` is symmetric with Gaussian entries of standard deviation ``size`` (``size / sqrt 2`` off the diagonal). Its
    distribution does not change under rotations, so neither the choice of L nor the link's frame matters. The result
    is symmetric positive definite for every E, and its geodesic distance to the nominal body is E's Frobenius norm.
    """
    root = np.linalg.cholesky(pseudo_inertia(nominal))
    draw = size * rng.standard_normal((4, 4))
    values, vectors = np.linalg.eigh(0.5 * (draw + draw.T))
    return body_of(nominal.name, root @ (vectors * np.exp(values)) @ vectors.T @ root.T)


def pseudo_inertia(body: LinkInertia) -> FloatArray:
    """Pseudo-inertia ``[[S, h], [h^T, m]] (4, 4)`` in the link frame: second moment S [kg m^2], h = m com [kg m]."""
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = _swap_moments(body.inertia, 0.5) + body.mass * np.outer(body.com, body.com)
    pseudo[:3, 3] = pseudo[3, :3] = body.mass * body.com
    pseudo[3, 3] = body.mass
    if np.linalg.eigvalsh(pseudo)[0] <= 0.0:
        raise InputError(f"link '{body.name}' has an inertia that no body can have; correct it in the URDF.")
    return pseudo


def body_of(name: str, pseudo: FloatArray) -> LinkInertia:
    """Body with the given pseudo-inertia ``(4, 4)``."""
    mass = float(pseudo[3, 3])
    com = pseudo[:3, 3] / mass
    inertia = _swap_moments(pseudo[:3, :3] - mass * np.outer(com, com), 1.0)
    return LinkInertia(name, mass, frozen(com), frozen(0.5 * (inertia + inertia.T)))


def _swap_moments(matrix: FloatArray, factor: float) -> FloatArray:
    """Second moment from rotational inertia (``factor`` 1/2) and back (``factor`` 1)."""
    return np.asarray(factor * np.trace(matrix) * np.eye(3) - matrix)


def set_inertia(mujoco: Any, element: Any, body: LinkInertia) -> None:
    """Set the inertia of an MjSpec body to that of ``body``, in the frame of that body."""
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    element.mass = body.mass
    element.ipos = body.com
    element.iquat = quaternion
    element.inertia = moments
    element.explicitinertial = True


def robot_names() -> tuple[str, ...]:
    """Names of the shipped robots, sorted."""
    names = (entry.name for entry in _SHIPPED.iterdir())
    return tuple(sorted(name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)))


def robot_description(robot: str) -> str:
    """URDF text of a shipped robot, or of the file at ``robot`` when that ends in ``.urdf``."""
    if robot.endswith(_SUFFIX):
        with refusing(f"{robot}: the URDF cannot be read", OSError, UnicodeDecodeError, advice="name a text file"):
            return Path(robot).read_text(encoding="utf-8")
    if robot not in robot_names():
        raise unknown_name("robot", robot, (*robot_names(), "path/to/your" + _SUFFIX))
    return _SHIPPED.joinpath(robot + _SUFFIX).read_text(encoding="utf-8")
