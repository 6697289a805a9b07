"""``geomid export``: an estimate in the terms of the software that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from geomid_ros.errors import InputError, one_line
from geomid_ros.exports.formats import CONTROLLERS, DESCRIPTIONS

if TYPE_CHECKING:
    from geomid_ros.exports.inertial import Export
    from geomid_ros.exports.model import Model


@click.command()
@click.argument("model", metavar="FROM", type=click.Path(path_type=Path))
@click.option(
    "--for", "tool", required=True, type=click.Choice([*CONTROLLERS, *DESCRIPTIONS]), help="Who is to read it."
)
@click.option(
    "--frame",
    metavar="LINK",
    help="The flange: a payload is what comes with or after this link, in its axes.  [default: for ur and franka the "
    "one link whose name ends with tool0 or link8]",
)
@click.option("--links", help="The payload is these links, separated by commas.")
@click.option(
    "--without",
    type=click.Path(path_type=Path),
    help="The payload is what this model (estimate.json or URDF) of the robot without it has not.",
)
def export(model: Path, tool: str, frame: str | None, links: str | None, without: Path | None) -> None:
    """Print an estimate in the terms of other software.

    FROM is an estimate.json with its identified.urdf beside it, or any URDF. For ur (Universal Robots) and franka, that
    is the payload at the flange, as commands for the controller and its ROS driver; for moveit, gazebo and mujoco, the
    inertial of every link, or with --frame of a payload. Standard deviations stand beside the numbers. What the data
    did not show is not exported as a payload. A model whose verdict is not 'usable' is warned of.
    """
    read = _read(model)
    if tool in CONTROLLERS:
        controller = CONTROLLERS[tool]
        payload = _payload(read, frame or _flange(read, controller.flange), links, without)
        click.echo(controller.commands(payload), nl=False)
    else:
        click.echo(DESCRIPTIONS[tool](_inertials(read, frame, links, without)), nl=False)


def _inertials(model: Model, frame: str | None, links: str | None, without: Path | None) -> list[Export]:
    if frame:
        return [_payload(model, frame, links, without)]
    if links or without:
        raise click.UsageError("Missing option '--frame': in the axes of which link?")
    from geomid_ros.exports.payload import each_link

    return each_link(model)


def _payload(model: Model, frame: str, links: str | None, without: Path | None) -> Export:
    if links and without:
        raise click.UsageError("A payload is either --links or what a model --without it lacks.")
    from geomid_ros.exports.payload import attached, chosen, difference

    if without:
        return difference(model, _read(without), frame)
    if links:
        return chosen(model, [name.strip() for name in links.split(",")], frame)
    return attached(model, frame)


def _read(path: Path) -> Model:
    """Read a model, and warn of one that should not be used."""
    from geomid_ros.exports.model import read_model

    model = read_model(path)
    if model.doubt:
        click.echo(f"Warning: {one_line(model.doubt)}", err=True)
    return model


def _flange(model: Model, ending: str) -> str:
    """The link that the flange is called in the manufacturer's URDF, with any prefix."""
    found = [link for link in model.tree.links if link.endswith(ending)]
    if len(found) != 1:
        listed = ", ".join(found or model.tree.links)
        raise InputError(f"{model.source}: which link is the flange? Name it with --frame: {listed}")
    return found[0]
