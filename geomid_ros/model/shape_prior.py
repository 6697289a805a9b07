"""Prior inertias from the links' shapes and the total mass: one density for all links.

This is the prior of the paper (Sec. V-B), for robots whose URDF has no usable inertials.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from copy import deepcopy
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import shapes, urdf_tree
from geomid_ros.model.urdf_tree import UrdfTree
from geomid_ros.types import FloatArray, IntArray

MISSING, ZERO, UNREADABLE, IMPOSSIBLE = "missing", "zero mass", "unreadable", "impossible"
OUTSIDE, POINT, DENSE, LIGHT = "mass beyond its shape", "nearly a point mass", "far too dense", "far too light"
# Links differ in material, and shapes are not exact: an inertial is implausible only beyond these limits.
_REACH = 2.0  # extent of the mass, in sizes of the shape
_POINT = 0.1  # radius of gyration, as a fraction of the shape's
_DENSITY = 10.0  # ratio to the robot's density


@dataclass(frozen=True, eq=False)
class Solid:
    """Solid of a link, in the link's frame.

    Attributes:
        moments: ``(4, 4)`` as in :mod:`shapes`.
        vertices, triangles: Surface mesh: corners ``(V, 3)`` [m] and their indices ``(T, 3)``.
        shape: Description of its source.
    """

    moments: FloatArray
    vertices: FloatArray
    triangles: IntArray
    shape: str


@dataclass(frozen=True, eq=False)
class UrdfInertial:
    """A link's inertial in the URDF: ``parameters (10,)``, None if none with a mass can be read, and its ``problem``,
    empty if there is none."""

    parameters: FloatArray | None
    problem: str

    @property
    def mass(self) -> float:
        """Mass [kg]; 0 if none can be read."""
        return 0.0 if self.parameters is None else float(self.parameters[0])


@dataclass(frozen=True, eq=False)
class LinkPrior:
    """Inertia of a link in the URDF and in the prior.

    Attributes:
        name, solid, before: The link, its solid, and its inertial in the URDF.
        parameters: ``(10,)`` from its shape; None if its inertial stays.
        verdict: Problem of its inertial in the URDF; empty if there is none.
    """

    name: str
    solid: Solid | None
    before: UrdfInertial
    parameters: FloatArray | None
    verdict: str

    @property
    def mass(self) -> float:
        """Mass of the link in the prior [kg]."""
        return self.before.mass if self.parameters is None else float(self.parameters[0])


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Links in the file's order, and the density [kg/m^3] of those with inertias from shapes."""

    links: tuple[LinkPrior, ...]
    density: float

    @property
    def mass(self) -> float:
        """Mass of all links in the prior [kg]."""
        return sum(link.mass for link in self.links)


def shape_prior(
    inertials: Mapping[str, UrdfInertial], solids: Mapping[str, Solid], total_mass: float, source: str
) -> ShapePrior:
    """Compute inertias of the links with ``solids``, so that the mass of all links is ``total_mass`` [kg].

    ``inertials`` are those of all links, in the file's order. Those without a solid stay, with the mass that they have.
    Raises InputError naming ``source``.
    """
    kept_mass = sum(inertial.mass for name, inertial in inertials.items() if name not in solids)
    volume = sum(shapes.volume(solid.moments) for solid in solids.values())
    if not solids:
        raise InputError(f"{source}: no link has a shape to compute its inertia from")
    if total_mass <= kept_mass:
        raise InputError(
            f"{source}: links that keep their inertials already have {kept_mass:.3f} kg, at least the total of "
            f"{total_mass:g} kg; no mass is left for the links with shapes"
        )
    density = (total_mass - kept_mass) / volume
    links = []
    for name, before in inertials.items():
        solid = solids.get(name)
        parameters = pseudo_inertia.to_parameters(density * solid.moments) if solid else None
        links.append(LinkPrior(name, solid, before, parameters, verdict(before, solid, density)))
    return ShapePrior(tuple(links), density)


def verdict(before: UrdfInertial, solid: Solid | None, density: float) -> str:
    """Return the problem with an inertial: impossible for any body, or for this shape; empty if there is none.

    If a body lies between a and b along an axis, its variance about its centre c is at most ``(b - c)(c - a)`` (Bhatia
    and Davis 2000). An inertial with a larger variance has mass outside.
    """
    if before.parameters is None or before.problem or solid is None:
        return before.problem
    parameters = before.parameters
    centre, variances = _centre_and_variances(pseudo_inertia.from_parameters(parameters))
    _, of_shape = _centre_and_variances(solid.moments)
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    margin = (_REACH - 1.0) / 2.0 * (high - low)
    below, above = centre - (low - margin), high + margin - centre
    if np.any(below < 0.0) or np.any(above < 0.0) or np.any(variances > below * above):
        return OUTSIDE
    if np.sum(variances) < _POINT**2 * np.sum(of_shape):
        return POINT
    ratio = float(parameters[0]) / (density * shapes.volume(solid.moments))
    if ratio > _DENSITY:
        return DENSE
    return LIGHT if ratio < 1.0 / _DENSITY else ""


def _centre_and_variances(pseudo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mass distribution's centre ``(3,)`` and axis variances ``(3,)`` of a pseudo-inertia ``(4, 4)``."""
    centre = pseudo[:3, 3] / pseudo[3, 3]
    return centre, np.diag(pseudo)[:3] / pseudo[3, 3] - centre**2


def massless_links(tree: UrdfTree, masses: Mapping[str, float]) -> tuple[list[str], list[str]]:
    """Find moving links that have no mass, nor have the links fixed to them: those with mass distal to them, and those
    without. The former are correct between the axes of a multi-axis joint; the latter leave their joint no load."""
    moving = [joint.child for joint in tree.joints if joint.type != "fixed"]
    massless = [link for link in moving if not _mass(tree, masses, link, through_joints=False)]
    between = [link for link in massless if _mass(tree, masses, link, through_joints=True)]
    return between, [link for link in massless if link not in between]


def _mass(tree: UrdfTree, masses: Mapping[str, float], link: str, *, through_joints: bool) -> float:
    """Return the mass [kg] of a link with the links fixed to it, or with its whole subtree."""
    children = [joint.child for joint in tree.children(link) if through_joints or joint.type == "fixed"]
    return masses[link] + sum(_mass(tree, masses, child, through_joints=through_joints) for child in children)


class ShapedUrdf:
    """A URDF whose inertials may be unusable.

    Attributes:
        links: ``<link>`` elements by name.
        inertials: Their inertials by name.
        tree: The tree without inertials.
    """

    def __init__(self, text: str, source: str) -> None:
        """Read the URDF. Raises InputError naming ``source`` if anything but an inertial is unusable."""
        robot = urdf_tree.read_xml(text, source)
        self.source = source
        self.tree = _tree_without_inertials(robot, source)
        self.links = {link.get("name", ""): link for link in robot.findall("link")}
        self.inertials = {name: _inertial(link, source) for name, link in self.links.items()}

    def check_staying(self, shaped: Collection[str]) -> None:
        """Refuse an unreadable inertial or a negative mass that no shape replaces (InputError)."""
        for name in self.inertials.keys() - set(shaped):
            parameters = urdf_tree.inertial_parameters(self.links[name], self.source)
            if parameters is not None and parameters[0] < 0.0:
                raise InputError(
                    f"{self.source}: link '{name}' has a mass of {parameters[0]:g} kg, which is kept, as it "
                    "has no shape or is in --keep; correct or remove its <inertial>"
                )


def _tree_without_inertials(robot: Element, source: str) -> UrdfTree:
    stripped = deepcopy(robot)
    for link in stripped.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    return urdf_tree.tree(stripped, source)


def _inertial(link: Element, source: str) -> UrdfInertial:
    try:
        parameters = urdf_tree.inertial_parameters(link, source)
    except InputError:
        return UrdfInertial(None, UNREADABLE)
    if parameters is None:
        return UrdfInertial(None, MISSING if link.find("inertial") is None else ZERO)
    return UrdfInertial(parameters, "" if pseudo_inertia.is_body(parameters) else IMPOSSIBLE)
