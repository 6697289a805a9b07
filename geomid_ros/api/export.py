"""From a model on disk to the terms of the software that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from geomid_ros.api.options import ExportOptions
from geomid_ros.api.robot import entries
from geomid_ros.errors import InputError, unknown_name
from geomid_ros.exports.descriptions import DESCRIPTIONS, Whole, described
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.exports.model import Model, read_model
from geomid_ros.exports.patch_mjcf import into_mjcf
from geomid_ros.exports.payload import Export, attached, chosen, difference, each_link
from geomid_ros.files.models.readers import INTO
from geomid_ros.options import takes
from geomid_ros.session.options import PathLike, Texts

_MUJOCO = "mujoco"


class Exported(NamedTuple):
    """The ``text`` for the other software, ``notes`` on what it lacks and ``doubts`` about the models, in sentences."""

    text: str
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


@takes(ExportOptions)
def export(options: ExportOptions) -> Exported:
    """An estimate in the terms of other software: a robot description, or the payload at a flange.

    ``geomid export`` calls this; its options have the same names, but ``--for`` for ``tool``. Without ``frame``, the
    whole robot is exported.

    Raises:
        InputError: the files or arguments cannot be used, the data do not tell what is asked for, or a model is
            doubtful and ``force`` is not given.
    """
    _check(options)
    tool = options.tool
    reader = "" if tool in CONTROLLERS else tool if options.into is None else INTO
    own = read_model(Path(options.model), reader)
    reference = None if options.without is None else read_model(Path(options.without))
    doubts = tuple(each.doubt for each in (own, reference) if each is not None and each.doubt)
    if doubts and not options.force:
        raise InputError(f"{doubts[0]}; mend that, or export it with --force")
    if tool in CONTROLLERS:
        flange = options.frame or _flange(own, CONTROLLERS[tool].flange)
        return Exported(CONTROLLERS[tool].commands(_payload(own, flange, options.links, reference)), (), doubts)
    if options.frame:
        return Exported(DESCRIPTIONS[tool].payload(_payload(own, options.frame, options.links, reference)), (), doubts)
    whole = _whole(own, options)
    return Exported(whole.text, tuple(whole.lacks), doubts)


def check_into(tool: str, into: PathLike | None) -> None:
    """Refuse an MJCF for another simulator. Raises InputError."""
    if into is not None and tool != _MUJOCO:
        raise InputError(f"into is a file of MuJoCo's: it goes with {_MUJOCO} (--for {_MUJOCO}), not with {tool}")


def _check(options: ExportOptions) -> None:
    """Refuse what makes no sense. Raises InputError."""
    tool, part = options.tool, options.links is not None or options.without is not None
    if tool not in (*CONTROLLERS, *DESCRIPTIONS):
        raise unknown_name("reader", tool, (*CONTROLLERS, *DESCRIPTIONS))
    check_into(tool, options.into)
    if options.links is not None and options.without is not None:
        raise InputError("links and without exclude each other: a payload is either these links or a difference")
    if tool not in CONTROLLERS and not options.frame and part:
        raise InputError("frame is missing: in the axes of which link is the payload wanted?")


def _whole(model: Model, options: ExportOptions) -> Whole:
    if options.into is not None:
        return into_mjcf(model, Path(options.into))
    return described(model, options.tool, each_link(model), options.package_path or {})


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
