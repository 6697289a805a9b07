"""``geomid export``: an estimate in the terms of the software that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from geomid_ros.commands.options import Names, package_option
from geomid_ros.errors import InputError, one_line
from geomid_ros.exports.formats import CONTROLLERS, DESCRIBED_FOR

if TYPE_CHECKING:
    from geomid_ros.exports.descriptions import Whole
    from geomid_ros.exports.inertial import Export
    from geomid_ros.exports.model import Model


@click.command()
@click.argument("model", metavar="FROM", type=click.Path(path_type=Path))
@click.option(
    "--for", "tool", required=True, type=click.Choice([*CONTROLLERS, *DESCRIBED_FOR]), help="Who is to read it."
)
@click.option(
    "--frame",
    metavar="LINK",
    help="The flange: a payload is what comes with or after this link, in its axes.  [default: for ur and franka the "
    "one link whose name ends with tool0 or link8]",
)
@click.option("--links", type=Names(), help="The payload is these links, separated by commas.")
@click.option(
    "--without",
    type=click.Path(path_type=Path),
    help="The payload is what this model (estimate.json or URDF) of the robot without it has not.",
)
@click.option(
    "--into",
    metavar="MJCF",
    type=click.Path(path_type=Path),
    help="For mujoco: print this file with what was identified of the bodies and joints of the same names, all else as "
    "it is.",
)
@click.option("--force", is_flag=True, help="Export a model whose verdict is not 'usable', too.")
@package_option
def export(
    model: Path,
    tool: str,
    frame: str | None,
    links: list[str] | None,
    without: Path | None,
    into: Path | None,
    force: bool,
    package_path: dict[str, Path],
) -> None:
    """Print an estimate in the terms of other software.

    FROM is an estimate.json with its identified.urdf beside it, or any URDF. For ur (Universal Robots) and franka, that
    is the payload at the flange, as commands for the controller and its ROS driver. For urdf, moveit, isaac, gazebo and
    drake it is the robot's URDF, for mujoco its MJCF, with inertias, friction, and what else each of these can say; or
    with --frame the inertial of a payload. Standard deviations stand beside the numbers or behind them. What a format
    cannot say is said. What the data did not show is not exported as a payload. A model whose verdict is not 'usable'
    is refused without --force.
    """
    if into and tool != "mujoco":
        raise click.UsageError("--into is a file of MuJoCo's: --for mujoco.")
    read = _read(model, force)
    if tool in CONTROLLERS:
        controller = CONTROLLERS[tool]
        payload = _payload(read, frame or _flange(read, controller.flange), links, without, force)
        click.echo(controller.commands(payload), nl=False)
        return
    from geomid_ros.exports.descriptions import DESCRIPTIONS
    from geomid_ros.exports.payload import each_link

    if frame:
        click.echo(DESCRIPTIONS[tool].payload(_payload(read, frame, links, without, force)), nl=False)
        return
    if links or without:
        raise click.UsageError("Missing option '--frame': in the axes of which link?")
    whole = _into(read, into) if into else DESCRIPTIONS[tool].robot(read, each_link(read), package_path)
    for sentence in whole.lacks:
        click.echo(f"Note: {one_line(sentence)}", err=True)
    click.echo(whole.text, nl=False)


def _into(model: Model, into: Path) -> Whole:
    from geomid_ros.exports.into import into_mjcf

    return into_mjcf(model, into)


def _payload(model: Model, frame: str, links: list[str] | None, without: Path | None, force: bool) -> Export:
    if links and without:
        raise click.UsageError("A payload is either --links or what a model --without it lacks.")
    from geomid_ros.exports.payload import attached, chosen, difference

    if without:
        return difference(model, _read(without, force), frame)
    if links:
        return chosen(model, links, frame)
    return attached(model, frame)


def _read(path: Path, force: bool) -> Model:
    """Read a model. Raises InputError for one that should not be used, unless that is forced."""
    from geomid_ros.exports.model import read_model

    model = read_model(path)
    if model.doubt and not force:
        raise InputError(f"{model.doubt}; mend that, or export it with --force")
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
