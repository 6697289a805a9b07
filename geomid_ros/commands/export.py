"""``geomid export``: an estimate in the terms of the software that uses it."""

from __future__ import annotations

from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import ExportOptions
from geomid_ros.commands.options import PATH, options_of
from geomid_ros.errors import one_line
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.files.models.readers import DESCRIBED_FOR


@click.command()
@click.argument("model", metavar="FROM", type=PATH)
@click.option(
    "--for", "tool", required=True, type=click.Choice([*CONTROLLERS, *DESCRIBED_FOR]), help="Format, or controller."
)
@options_of(ExportOptions)
def export(**options: Any) -> None:
    """Print an estimate in the format of other software.

    FROM is an estimate.json with its identified.urdf in the same folder, or any URDF. For ur (Universal Robots) and
    franka, prints the payload at the flange, as commands for the controller and its ROS driver. For urdf, moveit,
    isaac, gazebo and drake, prints a URDF of the robot; for mujoco, an MJCF. With --frame, prints the inertial of a
    payload instead. Each format gets its own fit, with only the parameters that it can hold; a note lists the others.
    Standard deviations are in comments. A payload that the data do not identify is refused, and so is a model whose
    verdict is not 'usable', without --force.

    Nothing is tested here: 'geomid identify --for' writes the same description and tests it on held-out data.
    """
    found = geomid_ros.export(**options)
    for heading, sentences in (("Warning", found.doubts), ("Note", found.notes)):
        for sentence in sentences:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    click.echo(found.text, nl=False)
