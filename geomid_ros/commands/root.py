"""The command group: what every command has in common."""

from __future__ import annotations

from typing import Any

import click

import geomid_ros
from geomid_ros.commands.demo import demo
from geomid_ros.commands.export import export
from geomid_ros.commands.gap import gap
from geomid_ros.commands.identify import identify
from geomid_ros.commands.play import play
from geomid_ros.commands.prior import prior
from geomid_ros.commands.simulate import simulate
from geomid_ros.errors import GeomidError


class _Failure(click.ClickException):
    """An error of ours on its way to the user: one message, exit status 2."""

    exit_code = 2


class _Group(click.Group):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except GeomidError as error:
            raise _Failure(str(error)) from error


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(geomid_ros.__version__, prog_name="geomid")
def root() -> None:
    """Find a robot's true link inertias, from rosbags or while it runs."""


for command in (identify, gap, prior, export, play, simulate, demo):
    root.add_command(command)
