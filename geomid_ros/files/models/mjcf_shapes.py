"""The shapes of a URDF's links as MJCF has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.se3 import quaternion
from geomid_ros.model.urdf_tree import origin_of, read_numbers, read_xml
from geomid_ros.types import FloatArray

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")
# Shapes to be seen touch nothing. Those to touch do not touch one another: a URDF does not say which ones may.
_KINDS = {
    "visual": {"contype": "0", "conaffinity": "0", "group": "2"},
    "collision": {"contype": "1", "conaffinity": "0", "group": "3"},
}


@dataclass(frozen=True, eq=False)
class Shapes:
    """The ``geoms`` of links by name, the ``assets`` that these need, and sentences on what is ``missing``."""

    geoms: dict[str, list[Element]] = field(default_factory=dict)
    assets: list[Element] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def mjcf_shapes(urdf: str, source: str, find: Callable[[str, str], Path]) -> Shapes:
    """The shapes of a URDF's links.

    Args:
        urdf: its text.
        source: names it in messages.
        find: the file of a mesh's URI, or an InputError that begins with its second argument.
    """
    found = Shapes()
    meshes: dict[tuple[str, str], str] = {}
    for link in read_xml(urdf, source).findall("link"):
        name = link.get("name", "")
        for kind, attributes in _KINDS.items():
            for element in link.findall(kind):
                where = f"{source}: link '{name}'"
                try:
                    geom = Element("geom", attributes | _placement(element, where) | _shape(element, where))
                    mesh = element.find("geometry/mesh")
                    if mesh is not None:
                        geom.set("mesh", _asset(found, meshes, mesh, where, find))
                except InputError as error:
                    found.missing.append(str(error))
                else:
                    found.geoms.setdefault(name, []).append(geom)
    return found


def _placement(element: Element, where: str) -> dict[str, str]:
    position, axes = origin_of(element, where)
    return {"pos": words(position), "quat": words(np.roll(quaternion(axes), 1))}


def _shape(element: Element, where: str) -> dict[str, str]:
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise InputError(f"{where}: a shape has no geometry")
    tag = geometry[0].tag
    if tag == "box":
        sizes = [0.5 * size for size in read_numbers(geometry, tag, ("size",), [0.0] * 3, where)]
    elif tag == "sphere":
        sizes = read_numbers(geometry, tag, ("radius",), None, where)
    elif tag in ("cylinder", "capsule"):
        radius, length = read_numbers(geometry, tag, ("radius", "length"), None, where)
        sizes = [radius, 0.5 * length]
    elif tag == "mesh":
        return {"type": "mesh"}
    else:
        raise InputError(f"{where}: MuJoCo has no shape <{tag}>")
    return {"type": tag, "size": words(sizes)}


def _asset(
    found: Shapes, meshes: dict[tuple[str, str], str], mesh: Element, where: str, find: Callable[[str, str], Path]
) -> str:
    """The name of a mesh among the assets, to which it is added once."""
    path, scale = find(mesh.get("filename", ""), where), mesh.get("scale", "1 1 1")
    if path.suffix.lower() not in _READ_BY_MUJOCO:
        raise InputError(f"{where}: MuJoCo reads no {path.suffix} ({path.name})")
    key = str(path.resolve()), scale
    if key not in meshes:
        meshes[key] = f"{path.stem}_{len(meshes)}"
        found.assets.append(Element("mesh", name=meshes[key], file=key[0], scale=scale))
    return meshes[key]


def words(numbers: FloatArray | Sequence[float] | float) -> str:
    """Numbers to the last bit."""
    return " ".join(repr(float(number)) for number in np.ravel(numbers))
