"""Convex shapes for collisions: of a URDF's links, and of what a user says is in the way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh

from geomid_ros.errors import InputError
from geomid_ros.files.shapes.meshes import SUFFIXES, MeshFinder, read_mesh
from geomid_ros.files.shapes.shapes import ShapeReader
from geomid_ros.model.collision import ConvexShape, HalfSpace, Obstacle
from geomid_ros.model.urdf_tree import read_xml

_FORMS = "box:X,Y,Z,LENGTH,WIDTH,HEIGHT, plane:NX,NY,NZ,OFFSET or a mesh file, in metres in the base frame"


def link_shapes(urdf: str, path: Path, packages: Mapping[str, Path]) -> dict[str, list[ConvexShape]]:
    """The convex hulls of the shapes of a URDF's links, by link.

    Args:
        urdf: its text.
        path: where it is from: meshes are looked for from there.
        packages: folders by package name, see :class:`MeshFinder`.

    Raises:
        InputError: a mesh cannot be read, or no link has a shape.
    """
    reader = ShapeReader(MeshFinder(path, packages), str(path))
    found = {}
    for link in read_xml(urdf, str(path)).findall("link"):
        name = link.get("name", "")
        outlines = reader.outlines(link)
        if outlines:
            found[name] = [ConvexShape(name, vertices) for vertices in outlines]
    if not found:
        raise InputError(
            f"{path}: no link has a <collision> or <visual> shape to check for collisions; add shapes, or "
            "give --no-collision if nothing can collide"
        )
    return found


def obstacles(text: str) -> list[Obstacle]:
    """What one ``--avoid`` says: a box about its centre, the half-space below a plane (points with ``n . x`` up to the
    offset), or a mesh, each of whose connected parts counts as its convex hull.

    Raises InputError naming it.
    """
    kind, _, rest = text.partition(":")
    if kind == "box":
        numbers = _numbers(rest, 6, text)
        if np.any(numbers[3:] <= 0.0):
            raise InputError(f"--avoid {text}: a box needs edges greater than zero")
        corners = np.array(np.meshgrid(*3 * [(-0.5, 0.5)])).reshape(3, -1).T
        return [ConvexShape(text, numbers[:3] + corners * numbers[3:])]
    if kind == "plane":
        numbers = _numbers(rest, 4, text)
        length = float(np.linalg.norm(numbers[:3]))
        if length == 0.0:
            raise InputError(f"--avoid {text}: the normal of the plane is zero")
        return [HalfSpace(text, numbers[:3] / length, float(numbers[3]) / length)]
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"--avoid {text}: expected {_FORMS}")
    mesh, _ = read_mesh(path, f"--avoid {text}")
    return [ConvexShape(text, np.asarray(part.vertices)) for part in _parts(mesh)]


def _parts(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    parts = mesh.split(only_watertight=True)
    return list(parts) or [mesh]


def _numbers(text: str, count: int, whole: str) -> np.ndarray:
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(f"--avoid {whole}: expected {_FORMS}") from error
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise InputError(f"--avoid {whole}: expected {count} finite numbers, as {_FORMS}")
    return numbers
