"""Convex shapes of a robot and of the user's obstacles, for collision checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.shapes import SUFFIXES, ShapeReader, read_mesh
from geomid_ros.model.collision import CollisionModel, ConvexShape, HalfSpace, Obstacle, Pair
from geomid_ros.model.robot import Robot
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.options import numbers_in
from geomid_ros.session.options import Surroundings, texts
from geomid_ros.types import FloatArray

_NOT_CHECKED = "collisions are not looked for (--no-collision): watch the robot"
_FORMS = "box:X,Y,Z,LENGTH,WIDTH,HEIGHT, plane:NX,NY,NZ,OFFSET or a mesh file, in metres in the base frame"
_NEIGHBOURS = 2  # joints between links whose hulls may overlap all the time


def collision_model(around: Surroundings, robot: Robot, source: Path) -> CollisionModel | None:
    """Collision model of a robot, whose URDF is from the file ``source``, and the obstacles; None if not requested.

    Raises InputError: the URDF has no shapes, or one cannot be read.
    """
    if not around.collision:
        if around.avoid:
            raise InputError("--avoid and --no-collision exclude each other")
        return None
    avoided = [obstacle for text in texts(around.avoid) for obstacle in obstacles(text)]
    return CollisionModel(robot, link_shapes(robot.urdf, source, around.package_path or {}), avoided)


def without_touching(collision: CollisionModel | None, start: FloatArray) -> tuple[Pair, ...]:
    """Exclude pairs of links that overlap at the start ``(J,)`` of a motion and are at most two joints apart, as their
    hulls are too coarse. Returns these pairs."""
    if collision is None:
        return ()
    touching = collision.distances(start[None])[0] <= 0.0
    touching &= np.count_nonzero(collision.reach, axis=1) <= _NEIGHBOURS
    touching &= np.array([not pair.is_obstacle for pair in collision.pairs], dtype=bool)
    pairs = tuple(collision.pairs[place] for place in np.flatnonzero(touching))
    collision.without(np.flatnonzero(touching))
    return tuple(dict.fromkeys(pairs))


def not_watched(collision: CollisionModel | None, excluded: Sequence[Pair]) -> list[str]:
    """Sentences on what is not checked: everything, or the ``excluded`` pairs."""
    if collision is None:
        return [_NOT_CHECKED]
    listing = "; ".join(map(str, excluded))
    return [f"not watched, as their convex hulls overlap at the start already: {listing}"] if listing else []


def link_shapes(urdf: str, path: Path, packages: Mapping[str, Path]) -> dict[str, list[ConvexShape]]:
    """Convex hulls of the shapes of a URDF's links, by link.

    Args:
        urdf: text of the URDF.
        path: its file, from which meshes are searched.
        packages: folders by package name, see :class:`~geomid_ros.files.shapes.MeshFinder`.

    Raises:
        InputError: a mesh cannot be read, or no link has a shape.
    """
    reader = ShapeReader(path, packages)
    outlines = {link.get("name", ""): reader.outlines(link) for link in read_xml(urdf, str(path)).findall("link")}
    hulls = {name: [ConvexShape(name, vertices) for vertices in shapes] for name, shapes in outlines.items() if shapes}
    if not hulls:
        raise InputError(
            f"{path}: no link has a <collision> or <visual> shape to check for collisions; add shapes, or "
            "give --no-collision if nothing can collide"
        )
    return hulls


def obstacles(text: str) -> list[Obstacle]:
    """Parse one ``--avoid``: a box about its centre, the half-space below a plane (points with ``n . x`` up to the
    offset), or a mesh, each of whose connected parts becomes its convex hull.

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
    parts = list(mesh.split(only_watertight=True)) or [mesh]
    return [ConvexShape(text, np.asarray(part.vertices)) for part in parts]


def _numbers(text: str, count: int, obstacle: str) -> np.ndarray:
    numbers = numbers_in(text)
    if len(numbers) != count:
        raise InputError(f"--avoid {obstacle}: expected {count} finite numbers, as {_FORMS}")
    return np.array(numbers)
