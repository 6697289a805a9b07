"""``geomid play``: a rosbag on live topics."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from geomid_ros.commands.progress import progress_bar
from geomid_ros.errors import InputError


@click.command()
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--rate", default=1.0, show_default=True, type=click.FloatRange(0.01, 100.0), help="Times real time.")
@click.option(
    "--wait", default=10.0, show_default=True, type=click.FloatRange(0.0), help="Wait so long for subscribers [s]."
)
def play(bag: Path, rate: float, wait: float) -> None:
    """Publish the topics of BAG live."""
    try:
        from geomid_ros.ros.player import play as published  # noqa: PLC0415 the other commands need no ROS
    except ImportError as error:
        raise InputError(f"ROS 2 is needed to play a bag, and cannot be imported ({error})") from error
    with progress_bar() as bar:
        task = bar.add_task(f"playing {bag.name}", total=None)
        for done, total in published(bag, rate, wait, partial(click.echo, err=True)):
            bar.update(task, completed=done, total=total)
    click.echo(f"Published all messages of {bag}")
