"""Mesh files of a robot description: where they are, and the solids in them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import trimesh
from scipy.spatial import QhullError
from trimesh.units import unit_conversion

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_bytes

SUFFIXES = (".stl", ".dae", ".obj")


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
