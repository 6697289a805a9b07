"""A URDF whose inertials need not be of any use: its tree, and what its inertials say."""

from __future__ import annotations

from collections.abc import Collection
from copy import deepcopy
from xml.etree.ElementTree import Element

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import urdf_tree
from geomid_ros.model.shape_prior import IMPOSSIBLE, MISSING, UNREADABLE, ZERO, Inertial
from geomid_ros.model.urdf_tree import UrdfTree


class ShapedUrdf:
    """``links`` are the elements by name, ``inertials`` what they say; ``tree`` is the tree without inertials."""

    def __init__(self, text: str, source: str) -> None:
        """Raises InputError naming ``source`` where anything but an inertial is not usable."""
        robot = urdf_tree.read_xml(text, source)
        self.source = source
        self.tree = _tree_without_inertials(robot, source)
        self.links = {link.get("name", ""): link for link in robot.findall("link")}
        self.inertials = {name: _inertial(link, source) for name, link in self.links.items()}

    def check_staying(self, shaped: Collection[str]) -> None:
        """Raise InputError for an inertial that no body may have and that no shape replaces."""
        for name in self.inertials.keys() - set(shaped):
            parameters = urdf_tree.inertial_parameters(self.links[name], self.source)
            if parameters is not None and parameters[0] < 0.0:
                raise InputError(
                    f"{self.source}: link '{name}' has a mass of {parameters[0]:g} kg, which would stay, as it is "
                    "kept or has no shape; correct or remove its <inertial>"
                )


def _tree_without_inertials(robot: Element, source: str) -> UrdfTree:
    stripped = deepcopy(robot)
    for link in stripped.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    return urdf_tree.tree(stripped, source)


def _inertial(link: Element, source: str) -> Inertial:
    try:
        parameters = urdf_tree.inertial_parameters(link, source)
    except InputError:
        return Inertial(None, UNREADABLE)
    if parameters is None:
        return Inertial(None, MISSING if link.find("inertial") is None else ZERO)
    return Inertial(parameters, "" if pseudo_inertia.is_body(parameters) else IMPOSSIBLE)
