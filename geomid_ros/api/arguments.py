"""What a user may say, as the rooms below want it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import bags_in
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.xacro import SUFFIX, urdf_of_xacro
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import recorded_description

PathLike: TypeAlias = str | Path
"""The path of a file or a folder."""
Paths: TypeAlias = PathLike | Sequence[PathLike]
"""One path or several."""
Texts: TypeAlias = str | Sequence[str]
"""One text or several."""
Config: TypeAlias = PathLike | Mapping[str, Any] | Configuration
"""A parameter file (YAML), or parameters by their full names, as in ``{"filter.cutoff": 8.0}``."""


def paths(given: Paths) -> list[Path]:
    """One path or several, as a list."""
    return [Path(path) for path in ([given] if isinstance(given, str | Path) else given)]


def bag_paths(given: Paths) -> list[Path]:
    """Bags, as a list; for a folder of bags, those in it."""
    return [bag for path in paths(given) for bag in bags_in(path)]


def texts(given: Texts) -> list[str]:
    """One text or several, as a list."""
    return [given] if isinstance(given, str) else list(given)


def entries(argument: str, given: Texts) -> list[str]:
    """One text or several, as the list that is given for a parameter, where an empty text would pass for none.

    Raises:
        InputError: a text is empty; it names the ``argument``.
    """
    result = texts(given)
    if not all(result):
        raise InputError(f"{argument}: the text is empty; omit the argument")
    return result


def beside(model: PathLike) -> Path:
    """The description that is written with an estimate.json."""
    return Path(model).parent / "identified.urdf"


class DescribedRobot(NamedTuple):
    """The ``text`` of a URDF, its ``source``, and ``notes`` on where it was found if nobody named it."""

    text: str
    source: str
    notes: tuple[str, ...] = ()


def description(
    urdf: PathLike | None, bags: Sequence[Path], *, model: PathLike | None = None, xacro_args: Texts = ()
) -> DescribedRobot:
    """The robot description.

    Args:
        urdf: path of the file, or the text itself; None for the identified.urdf beside ``model``, or else what is
            recorded in the ``bags``.
        bags: of the robot.
        model: an estimate.json to start from.
        xacro_args: arguments, as ``NAME:=VALUE``, if ``urdf`` is the path of a .xacro file, which is then run.

    Raises:
        InputError: there is none, or the file cannot be read.
    """
    if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
        return DescribedRobot(urdf, "robot description")
    if urdf is not None and Path(urdf).suffix == SUFFIX:
        return DescribedRobot(urdf_of_xacro(Path(urdf), texts(xacro_args)), str(urdf))
    if xacro_args:
        raise InputError(f"arguments for xacro are given, and {urdf or 'no file'} is not a {SUFFIX} file")
    if urdf is not None:
        return DescribedRobot(read_urdf(Path(urdf)), str(urdf))
    if model is not None and (own := beside(model)).is_file():
        text, source = read_urdf(own), str(own)
    else:
        text, source = recorded_description(bags)
    return DescribedRobot(text, source, (f"no --urdf is given: using the description of {source}",))
