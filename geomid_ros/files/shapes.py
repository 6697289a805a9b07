"""Solids that fill a URDF's links: collision shapes, or visual ones if there are no others. Reading of mesh files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from scipy.spatial import QhullError
from trimesh import creation
from trimesh.units import unit_conversion

from geomid_ros.errors import InputError, refusing
from geomid_ros.files.disk import read_bytes
from geomid_ros.files.models.urdf import MeshFinder
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import shapes
from geomid_ros.model.shape_prior import Solid
from geomid_ros.model.urdf_tree import origin_of, read_numbers
from geomid_ros.types import FloatArray, IntArray

SUFFIXES = (".stl", ".dae", ".obj")
# Attributes of the primitives: one number each, except for the three edges of a box.
_PRIMITIVES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
# Resolution of round surfaces, which only serve to compute overlaps with other shapes.
_SECTIONS, _SUBDIVISIONS = 128, 4
# Relative tolerance of volumes, as surfaces are joined in single precision.
_ROUNDING = 1e-5
_NO_VOLUME = "shapes without volume, ignored"
_NOT_CLOSED = "meshes that are not closed, replaced by their convex hulls"
_NOT_MERGED = "shapes that cannot be merged, so their overlap counts twice"


@dataclass(frozen=True, eq=False)
class _Shape:
    """A shape: its ``moments (4, 4)``, and its ``surface``, all of whose corners lie on the true surface."""

    moments: FloatArray
    surface: trimesh.Trimesh
    name: str

    def moved(self, placement: FloatArray) -> _Shape:
        """Return the shape after an affine map ``(4, 4)``."""
        return _Shape(shapes.moved(self.moments, placement), self.surface.copy().apply_transform(placement), self.name)


class ShapeReader:
    """Reads the solids of links; :attr:`warnings` list the shapes that had to be replaced or ignored."""

    def __init__(self, urdf: Path, packages: Mapping[str, Path]) -> None:
        """Prepare to read the links of the file ``urdf``; ``packages`` as for :class:`MeshFinder`."""
        self._problems: dict[str, list[str]] = {problem: [] for problem in (_NO_VOLUME, _NOT_CLOSED, _NOT_MERGED)}
        self._finder = MeshFinder(urdf, packages)
        self._source = str(urdf)

    @property
    def warnings(self) -> list[str]:
        """One sentence per kind of problem, with all links that have it."""
        problems = self._problems.items()
        return [f"{problem}: {', '.join(dict.fromkeys(places))}" for problem, places in problems if places]

    def solid(self, link: Element) -> Solid | None:
        """Return the solid of a ``<link>``; None if its shapes have no volume.

        It is the union of the collision shapes, or of the visual shapes if there are no others. Collision shapes are
        usually closed and solid, whereas visual ones are often only covers.

        Raises InputError naming the link.
        """
        for kind in ("collision", "visual"):
            parts = list(self._shapes(link, kind))
            if parts:
                name = parts[0].name if len(parts) == 1 else f"{len(parts)} shapes"
                return Solid(self._union(parts, link.get("name", "")), *_together(parts), f"{kind}: {name}")
        return None

    def outlines(self, link: Element) -> list[FloatArray]:
        """Corners ``(V, 3)`` [m] of each shape of a ``<link>``, in the link's frame. The collision shapes count, or the
        visual ones if there are no others.

        Raises InputError naming the link.
        """
        parts = list(self._shapes(link, "collision")) or list(self._shapes(link, "visual"))
        return [np.asarray(shape.surface.vertices) for shape in parts]

    def _shapes(self, link: Element, kind: str) -> Iterator[_Shape]:
        """Yield the shapes of one kind in the link's frame, without those that have no volume."""
        name = link.get("name", "")
        where = f"{self._source}: link '{name}'"
        for element in link.findall(kind):
            for geometry in element.findall("geometry"):
                for tag in (child.tag for child in geometry[:1]):
                    shape = self._mesh(geometry, name, where) if tag == "mesh" else _primitive(geometry, tag, where)
                    if shape is None:
                        self._problems[_NO_VOLUME].append(f"{kind} {tag} of {name}")
                    else:
                        position, axes = origin_of(element, where)
                        yield shape.moved(pseudo_inertia.change_of_frame(axes, position))

    def _mesh(self, geometry: Element, link: str, where: str) -> _Shape | None:
        scale = read_numbers(geometry, "mesh", ("scale",), [1.0, 1.0, 1.0], where)
        uri = geometry[0].get("filename", "")
        mesh, closed = read_mesh(self._finder.find(uri, where), where)
        if np.prod(scale) == 0.0 or not mesh.is_volume:
            return None
        name = PurePosixPath(uri).name
        if not closed:
            self._problems[_NOT_CLOSED].append(f"{name} of {link}")
            name = f"hull of {name}"
        shape = _Shape(shapes.polyhedron(mesh.vertices, mesh.faces), mesh, name)
        return shape.moved(np.diag([*scale, 1.0]))

    def _union(self, parts: Sequence[_Shape], link: str) -> FloatArray:
        """Moments ``(4, 4)`` of the union: the sum, minus the overlap of the surfaces.

        The surface of a round shape lies inside it, and the part between both is a solid. So the result belongs to a
        solid.
        """
        total: FloatArray = np.sum([shape.moments for shape in parts], axis=0)
        if len(parts) == 1:
            return total
        separate = [shapes.polyhedron(shape.surface.vertices, shape.surface.faces) for shape in parts]
        volumes = [shapes.volume(moments) for moments in separate]
        union = _union_of_surfaces([shape.surface for shape in parts])
        if not (1.0 - _ROUNDING) * max(volumes) < shapes.volume(union) < (1.0 + _ROUNDING) * sum(volumes):
            self._problems[_NOT_MERGED].append(link)
            return total
        overlap: FloatArray = np.sum(separate, axis=0) - union
        return total - overlap if shapes.volume(overlap) > _ROUNDING * sum(volumes) else total


def _union_of_surfaces(surfaces: Sequence[trimesh.Trimesh]) -> FloatArray:
    """Moments ``(4, 4)`` of the union of the surfaces; zero if they cannot be joined."""
    try:
        united = trimesh.boolean.union(surfaces, engine="manifold", check_volume=False)
    except ImportError:  # rosdep has no key for manifold3d
        return np.zeros((4, 4))
    return shapes.polyhedron(united.vertices, united.faces)


def _together(parts: Sequence[_Shape]) -> tuple[FloatArray, IntArray]:
    """Concatenated corners ``(V, 3)`` and triangles ``(T, 3)`` of all surfaces."""
    starts = np.cumsum([0, *(len(shape.surface.vertices) for shape in parts[:-1])])
    triangles = [shape.surface.faces + start for shape, start in zip(parts, starts, strict=True)]
    return np.concatenate([shape.surface.vertices for shape in parts]), np.concatenate(triangles)


def _primitive(geometry: Element, tag: str, where: str) -> _Shape | None:
    """Primitive about its centre; None if it has no volume."""
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


def read_mesh(path: Path, where: str) -> tuple[trimesh.Trimesh, bool]:
    """Read the solid in a mesh file, in metres, and True; if its surface is not closed, its convex hull and False.

    As in RViz, the unit of a Collada file is applied and its upward axis is ignored. No other file is opened, though a
    mesh may name materials. Raises InputError beginning with ``where``, also for a surface that is flat and not closed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{where}: {path} is not a readable mesh; expected {', '.join(SUFFIXES)}")
    try:
        content = read_bytes(path, "mesh")
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    with refusing(f"{where}: {path} cannot be read", Exception):  # a broken file makes its reader raise any error
        scene = trimesh.load_scene(BytesIO(content), file_type=suffix[1:], skip_materials=True)
        unit = unit_conversion(scene.units, "meters") if scene.units else 1.0
        loaded = scene.to_mesh()
    vertices = unit * np.asarray(loaded.vertices, dtype=np.float64)
    if not len(loaded.faces) or not np.all(np.isfinite(vertices)):
        raise InputError(f"{where}: {path} has no triangles with finite vertices")
    mesh = trimesh.Trimesh(vertices, loaded.faces, process=True)
    if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume < 0.0:
        mesh.invert()
    if mesh.is_volume:
        return mesh, True
    try:
        return mesh.convex_hull, False
    except QhullError as error:
        raise InputError(f"{where}: {path} is flat and encloses no volume") from error
