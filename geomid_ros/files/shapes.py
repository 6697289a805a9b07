"""The solids that fill a URDF's links (collision shapes, or visual ones where a link has no others), and the mesh files
that they are in."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from scipy.spatial import QhullError
from trimesh import creation
from trimesh.units import unit_conversion

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_bytes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import shapes
from geomid_ros.model.shape_prior import Solid
from geomid_ros.model.urdf_tree import origin_of, read_numbers
from geomid_ros.types import FloatArray, IntArray

SUFFIXES = (".stl", ".dae", ".obj")
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

    def __init__(self, urdf: Path, packages: Mapping[str, Path]) -> None:
        """The links are those of the file ``urdf``; ``packages`` as for :class:`MeshFinder`."""
        self._no_volume: list[str] = []
        self._hulls: list[str] = []
        self._doubled: list[str] = []
        self._finder = MeshFinder(urdf, packages)
        self._source = str(urdf)

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
    position, axes = origin_of(element, where)
    return pseudo_inertia.change_of_frame(axes, position)


class MeshFinder:
    """Finds the file that a URDF's mesh URI names."""

    def __init__(self, urdf: Path, packages: Mapping[str, Path]) -> None:
        """``packages``: folders by package name, which win. Others are looked for above the ``urdf``, in
        ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH."""
        self._folder = urdf.resolve().parent
        self._packages = packages

    def find(self, uri: str, where: str) -> Path:
        """The file of a ``package://`` or ``file://`` URI or of a path, relative ones from the URDF's folder.

        Raises InputError beginning with ``where``.
        """
        scheme, separator, rest = uri.partition("://")
        if not separator:
            candidates = [self._folder / uri]
        elif scheme == "file":
            candidates = [Path(unquote(rest))]
        elif scheme == "package":
            package, _, inside = unquote(rest).partition("/")
            candidates = [folder / inside for folder in self._folders(package)]
        else:
            raise InputError(f"{where}: the mesh '{uri}' is neither a package:// nor a file:// URI nor a path")
        for path in candidates:
            if path.exists() and not path.is_dir():
                return path
        raise InputError(f"{where}: the mesh '{uri}' was not found. {_advice(uri, candidates)}")

    def _folders(self, package: str) -> list[Path]:
        if package in self._packages:
            return [self._packages[package]]
        above = [folder for folder in (self._folder, *self._folder.parents) if folder.name == package]
        sources = [Path(folder) for folder in _path_list("ROS_PACKAGE_PATH")]
        above += [folder for source in sources for folder in (source, source / package) if folder.name == package]
        return above + [Path(prefix) / "share" / package for prefix in _path_list("AMENT_PREFIX_PATH")]


def _path_list(variable: str) -> list[str]:
    return [part for part in os.environ.get(variable, "").split(os.pathsep) if part]


def _advice(uri: str, candidates: list[Path]) -> str:
    looked = f"Looked in {', '.join(map(str, candidates))}. " if candidates else ""
    if not uri.startswith("package://"):
        return looked.rstrip()
    package = uri.removeprefix("package://").partition("/")[0]
    return f"{looked}Locate the package: --package-path {package}=FOLDER, or source its workspace"


def read_mesh(path: Path, where: str) -> tuple[trimesh.Trimesh, bool]:
    """The solid in a mesh file, in metres, and whether its surface is closed; if it is not, its convex hull.

    As in RViz, the unit of a Collada file counts and its upward axis does not. No other file is opened, though a mesh
    may name materials. Raises InputError beginning with ``where``, also for a surface that is not closed and flat.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{where}: {path} is not a readable mesh; expected {', '.join(SUFFIXES)}")
    try:
        content = read_bytes(path, "mesh")
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    try:
        scene = trimesh.load_scene(BytesIO(content), file_type=suffix[1:], skip_materials=True)
        unit = unit_conversion(scene.units, "meters") if scene.units else 1.0
        loaded = scene.to_mesh()
    except Exception as error:  # whatever a broken file makes its reader raise
        raise InputError(f"{where}: {path} cannot be read ({error})") from error
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
