"""``geomid export``: an estimate in the terms of the software that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import Names, package_option
from geomid_ros.errors import one_line
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.files.models.readers import DESCRIBED_FOR


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
def export(**options: Any) -> None:
    """Print an estimate in the terms of other software.

    FROM is an estimate.json with its identified.urdf beside it, or any URDF. For ur (Universal Robots) and franka, that
    is the payload at the flange, as commands for the controller and its ROS driver. For urdf, moveit, isaac, gazebo and
    drake it is the robot's URDF, for mujoco its MJCF, with inertias, friction, and what else each of these can say; or
    with --frame the inertial of a payload. Standard deviations stand beside the numbers or behind them. What a format
    cannot say is said. What the data did not show is not exported as a payload. A model whose verdict is not 'usable'
    is refused without --force.
    """
    found = geomid_ros.export(**options)
    for heading, sentences in (("Warning", found.doubts), ("Note", found.notes)):
        for sentence in sentences:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    click.echo(found.text, nl=False)
