"""The solids that fill a URDF's links (collision shapes, or visual ones where a link has no others); and convex shapes
for collisions, of these links and of what a user says is in the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from trimesh import creation

from geomid_ros.errors import InputError
from geomid_ros.files.shapes.meshes import SUFFIXES, MeshFinder, read_mesh
from geomid_ros.model import shapes
from geomid_ros.model.collision import ConvexShape, HalfSpace, Obstacle
from geomid_ros.model.shape_prior import Solid
from geomid_ros.model.urdf_tree import origin_of, read_numbers, read_xml
from geomid_ros.types import FloatArray, IntArray

# Attributes of the primitives: one number each, but for the edges of a box.
_PRIMITIVES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
# Of the surfaces of round shapes, with which only their overlap with others is computed.
_SECTIONS, _SUBDIVISIONS = 128, 4
# Surfaces are joined in single precision.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class _Shape:
    """One shape: its ``moments (4, 4)``, and a ``surface`` that lies on it with all its corners."""

    moments: FloatArray
    surface: trimesh.Trimesh
    name: str

    def moved(self, placement: FloatArray) -> _Shape:
        """The shape after an affine map ``(4, 4)``."""
        return _Shape(shapes.moved(self.moments, placement), self.surface.copy().apply_transform(placement), self.name)


class ShapeReader:
    """Reads the solids of links; :attr:`warnings` list what could not be taken as it is."""

    def __init__(self, finder: MeshFinder, source: str) -> None:
        """``source`` names the URDF in messages."""
        self._no_volume: list[str] = []
        self._hulls: list[str] = []
        self._doubled: list[str] = []
        self._finder = finder
        self._source = source

    @property
    def warnings(self) -> list[str]:
        """One sentence for each thing that was found, with all links where it was."""
        found = {
            "shapes without volume, ignored": self._no_volume,
            "meshes that are not closed, replaced by their convex hulls": self._hulls,
            "shapes that cannot be merged, so their overlap counts twice": self._doubled,
        }
        return [f"{what}: {', '.join(dict.fromkeys(where))}" for what, where in found.items() if where]

    def solid(self, link: Element) -> Solid | None:
        """The solid of a ``<link>``; None if its shapes have no volume.

        It is the union of the collision shapes, which usually are closed and solid where visual ones often are mere
        covers; of the visual shapes if there are no others.

        Raises InputError naming the link.
        """
        for kind in ("collision", "visual"):
            found = list(self._shapes(link, kind))
            if found:
                name = found[0].name if len(found) == 1 else f"{len(found)} shapes"
                return Solid(self._union(found, link.get("name", "")), *_together(found), f"{kind}: {name}")
        return None

    def outlines(self, link: Element) -> list[FloatArray]:
        """Corners ``(V, 3)`` [m] of each shape of a ``<link>``, in its frame: of the collision shapes, or of the visual
        ones if there are no others.

        Raises InputError naming the link.
        """
        found = list(self._shapes(link, "collision")) or list(self._shapes(link, "visual"))
        return [np.asarray(shape.surface.vertices) for shape in found]

    def _shapes(self, link: Element, kind: str) -> Iterator[_Shape]:
        """The shapes of one kind in the link's frame, without those of no volume."""
        name = link.get("name", "")
        where = f"{self._source}: link '{name}'"
        for element in link.findall(kind):
            for geometry in element.findall("geometry"):
                for tag in (child.tag for child in geometry[:1]):
                    shape = self._mesh(geometry, name, where) if tag == "mesh" else _primitive(geometry, tag, where)
                    if shape is None:
                        self._no_volume.append(f"{kind} {tag} of {name}")
                    else:
                        yield shape.moved(_placement(element, where))

    def _mesh(self, geometry: Element, link: str, where: str) -> _Shape | None:
        scale = read_numbers(geometry, "mesh", ("scale",), [1.0, 1.0, 1.0], where)
        uri = geometry[0].get("filename", "")
        mesh, closed = read_mesh(self._finder.find(uri, where), where)
        if np.prod(scale) == 0.0 or not mesh.is_volume:
            return None
        name = PurePosixPath(uri).name
        if not closed:
            self._hulls.append(f"{name} of {link}")
            name = f"hull of {name}"
        shape = _Shape(shapes.polyhedron(mesh.vertices, mesh.faces), mesh, name)
        return shape.moved(np.diag([*scale, 1.0]))

    def _union(self, found: Sequence[_Shape], link: str) -> FloatArray:
        """Moments ``(4, 4)`` of the union: the sum, less what surfaces have in common.

        The surface of a round shape lies within it, so that what it lacks is a solid too: the difference is one.
        """
        total: FloatArray = np.sum([shape.moments for shape in found], axis=0)
        if len(found) == 1:
            return total
        apart = [shapes.polyhedron(shape.surface.vertices, shape.surface.faces) for shape in found]
        volumes = [shapes.volume(moments) for moments in apart]
        together = _union_of_surfaces([shape.surface for shape in found])
        if not (1.0 - _ROUNDING) * max(volumes) < shapes.volume(together) < (1.0 + _ROUNDING) * sum(volumes):
            self._doubled.append(link)
            return total
        overlap: FloatArray = np.sum(apart, axis=0) - together
        return total - overlap if shapes.volume(overlap) > _ROUNDING * sum(volumes) else total


def _union_of_surfaces(surfaces: Sequence[trimesh.Trimesh]) -> FloatArray:
    """Moments ``(4, 4)`` within any of the surfaces; zero if they cannot be joined."""
    try:
        united = trimesh.boolean.union(surfaces, engine="manifold", check_volume=False)
    except ImportError:  # no rosdep key brings manifold3d
        return np.zeros((4, 4))
    return shapes.polyhedron(united.vertices, united.faces)


def _together(found: Sequence[_Shape]) -> tuple[FloatArray, IntArray]:
    """Corners ``(V, 3)`` and triangles ``(T, 3)`` of all surfaces."""
    starts = np.cumsum([0, *(len(shape.surface.vertices) for shape in found[:-1])])
    triangles = [shape.surface.faces + start for shape, start in zip(found, starts, strict=True)]
    return np.concatenate([shape.surface.vertices for shape in found]), np.concatenate(triangles)


def _primitive(geometry: Element, tag: str, where: str) -> _Shape | None:
    """A primitive about its own centre; None if it has no volume."""
    if tag not in _PRIMITIVES:
        raise InputError(f"{where}: a shape is a <{tag}>. Valid: {', '.join(_PRIMITIVES)}, mesh")
    keys = _PRIMITIVES[tag]
    sizes = read_numbers(geometry, tag, keys, [0.0] * (3 if tag == "box" else len(keys)), where)
    if min(sizes) < 0.0:
        raise InputError(f"{where}: a {tag} has a negative {' or '.join(keys)}")
    if 0.0 in sizes:
        return None
    if tag == "box":
        return _Shape(shapes.box(np.array(sizes)), creation.box(sizes), tag)
    if tag == "cylinder":
        radius, length = sizes
        return _Shape(shapes.cylinder(radius, length), creation.cylinder(radius, length, sections=_SECTIONS), tag)
    return _Shape(shapes.sphere(sizes[0]), creation.icosphere(_SUBDIVISIONS, sizes[0]), tag)


def _placement(element: Element, where: str) -> FloatArray:
    """The ``<origin>`` of a shape, ``(4, 4)``."""
    placement = np.eye(4)
    placement[:3, 3], placement[:3, :3] = origin_of(element, where)
    return placement


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
