"""Robots that ship with the package, as mesh-free URDF files in this folder."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from geomid_ros.errors import refusing, unknown_name

WRIST_FRAME = "wrist_ft"
"""Link with the wrench sensor on every shipped robot."""

_SUFFIX = ".urdf"


def robot_names() -> tuple[str, ...]:
    """Names of the shipped robots, sorted."""
    names = (entry.name for entry in files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)))


def robot_description(robot: str) -> str:
    """URDF text of a shipped robot, or of the file at ``robot`` when that ends in ``.urdf``."""
    if robot.endswith(_SUFFIX):
        with refusing(f"{robot}: the URDF cannot be read", OSError, UnicodeDecodeError, advice="name a text file"):
            return Path(robot).read_text(encoding="utf-8")
    if robot not in robot_names():
        raise unknown_name("robot", robot, (*robot_names(), "path/to/your" + _SUFFIX))
    return files(__name__).joinpath(robot + _SUFFIX).read_text(encoding="utf-8")
