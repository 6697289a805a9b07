"""From a model on disk to the terms of the software that uses it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from geomid_ros.api.options import PathLike, Texts, entries
from geomid_ros.errors import InputError, unknown_name
from geomid_ros.exports.descriptions import DESCRIPTIONS, Whole, described
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.exports.inertial import Export
from geomid_ros.exports.model import Model, read_model
from geomid_ros.exports.patch_mjcf import into_mjcf
from geomid_ros.exports.payload import attached, chosen, difference, each_link
from geomid_ros.files.models.readers import INTO

_MUJOCO = "mujoco"


class Exported(NamedTuple):
    """The ``text`` for the other software, ``notes`` on what it lacks and ``doubts`` about the models, in sentences."""

    text: str
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


def export(
    model: PathLike,
    tool: str,
    *,
    frame: str | None = None,
    links: Texts | None = None,
    without: PathLike | None = None,
    into: PathLike | None = None,
    force: bool = False,
    package_path: Mapping[str, Path] | None = None,
) -> Exported:
    """An estimate in the terms of other software: a robot description, or the payload at a flange.

    ``geomid export`` calls this; its options have the same names, but ``--for`` for ``tool``.

    Args:
        model: an estimate.json with its identified.urdf beside it, or a URDF.
        tool: who is to read it: ur, franka, urdf, moveit, isaac, gazebo, drake or mujoco.
        frame: the flange: a payload is what comes with or after this link, in its axes; None for the whole robot, or
            for ur and franka the one link whose name ends with tool0 or link8.
        links: the payload is these links.
        without: the payload is what this model (estimate.json or URDF) of the robot without it has not.
        into: an MJCF that is to get what was identified, for mujoco.
        force: export a model whose verdict is not usable, too.
        package_path: folders of ROS packages, by name.

    Raises:
        InputError: the files or arguments cannot be used, the data do not tell what is asked for, or a model is
            doubtful and ``force`` is not given.
    """
    _check(tool, frame, links, without, into)
    reader = "" if tool in CONTROLLERS else tool if into is None else INTO
    own = read_model(Path(model), reader)
    reference = None if without is None else read_model(Path(without))
    doubts = tuple(each.doubt for each in (own, reference) if each is not None and each.doubt)
    if doubts and not force:
        raise InputError(f"{doubts[0]}; mend that, or export it with --force")
    if tool in CONTROLLERS:
        flange = frame or _flange(own, CONTROLLERS[tool].flange)
        return Exported(CONTROLLERS[tool].commands(_payload(own, flange, links, reference)), (), doubts)
    if frame:
        return Exported(DESCRIPTIONS[tool].payload(_payload(own, frame, links, reference)), (), doubts)
    whole = _whole(own, tool, into, package_path or {})
    return Exported(whole.text, tuple(whole.lacks), doubts)


def check_into(tool: str, into: PathLike | None) -> None:
    """Refuse an MJCF for another simulator. Raises InputError."""
    if into is not None and tool != _MUJOCO:
        raise InputError(f"into is a file of MuJoCo's: it goes with {_MUJOCO} (--for {_MUJOCO}), not with {tool}")


def _check(tool: str, frame: str | None, links: Texts | None, without: PathLike | None, into: PathLike | None) -> None:
    """Refuse what makes no sense. Raises InputError."""
    if tool not in (*CONTROLLERS, *DESCRIPTIONS):
        raise unknown_name("reader", tool, (*CONTROLLERS, *DESCRIPTIONS))
    check_into(tool, into)
    if links is not None and without is not None:
        raise InputError("links and without exclude each other: a payload is either these links or a difference")
    if tool not in CONTROLLERS and not frame and (links is not None or without is not None):
        raise InputError("frame is missing: in the axes of which link is the payload wanted?")


def _whole(model: Model, tool: str, into: PathLike | None, packages: Mapping[str, Path]) -> Whole:
    if into is not None:
        return into_mjcf(model, Path(into))
    return described(model, tool, each_link(model), packages)


def _payload(model: Model, frame: str, links: Texts | None, reference: Model | None) -> Export:
    if reference is not None:
        return difference(model, reference, frame)
    return attached(model, frame) if links is None else chosen(model, entries("links", links), frame)


def _flange(model: Model, ending: str) -> str:
    """The link that the flange is called in the manufacturer's URDF, with any prefix."""
    found = [link for link in model.tree.links if link.endswith(ending)]
    if len(found) != 1:
        listed = ", ".join(found or model.tree.links)
        raise InputError(f"{model.source}: which link is the flange? Name it with --frame: {listed}")
    return found[0]
