"""Robots that ship with the package, as mesh-free URDF files in this folder."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from geomid_ros.errors import InputError, unknown_name

WRIST_FRAME = "wrist_ft"
"""Link with the wrench sensor on every shipped robot."""

_SUFFIX = ".urdf"


def robot_names() -> tuple[str, ...]:
    """Names of the shipped robots, sorted."""
    return tuple(sorted(entry.name[: -len(_SUFFIX)] for entry in files(__name__).iterdir() if _is_urdf(entry.name)))


def robot_description(robot: str) -> str:
    """URDF text of a shipped robot, or of the file at ``robot`` when that ends in ``.urdf``."""
    if _is_urdf(robot):
        return _read(Path(robot))
    if robot not in robot_names():
        raise unknown_name("robot", robot, (*robot_names(), "path/to/your" + _SUFFIX))
    return files(__name__).joinpath(robot + _SUFFIX).read_text(encoding="utf-8")


def _is_urdf(name: str) -> bool:
    return name.endswith(_SUFFIX)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the URDF {path}: {error}. Give the path of an existing text file.") from error
