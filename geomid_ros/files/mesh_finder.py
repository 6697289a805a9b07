"""Where the files of a URDF's meshes are."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from geomid_ros.errors import InputError


class MeshFinder:
    """Finds the file of a URDF's mesh URI."""

    def __init__(self, urdf: Path, packages: Mapping[str, Path]) -> None:
        """Set where meshes are searched. ``packages``: folders by package name, which take precedence. Other packages
        are searched above the ``urdf``, in ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH."""
        self._folder = urdf.resolve().parent
        self._packages = packages

    def find(self, uri: str, where: str) -> Path:
        """Find the file of a ``package://`` or ``file://`` URI or a path; relative paths start at the URDF's folder.

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
