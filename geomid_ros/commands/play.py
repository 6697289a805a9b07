"""``geomid play``: a rosbag on live topics."""

from __future__ import annotations

from pathlib import Path

import click

from geomid_ros.commands.options import PATH
from geomid_ros.commands.terminal import progress_bar
from geomid_ros.errors import needing_ros, printable


@click.command()
@click.argument("bag", type=PATH)
@click.option(
    "--rate",
    default=1.0,
    show_default=True,
    type=click.FloatRange(0.01, 100.0),
    help="Playback speed, relative to real time.",
)
@click.option(
    "--wait", default=10.0, show_default=True, type=click.FloatRange(0.0), help="Longest wait for subscribers [s]."
)
@click.option(
    "--topic", multiple=True, help="Also publish this topic; may be repeated. A robot will follow recorded commands."
)
@click.option(
    "--config", type=PATH, help="The node's parameter file (YAML); also publish the topics of its wrench sensors."
)
def play(bag: Path, rate: float, wait: float, topic: tuple[str, ...], config: Path | None) -> None:
    """Play a rosbag on live topics.

    Publishes only the topics of BAG that geomid reads: joint_states, odom, imu and robot_description in any
    namespace, and /clock.
    """
    from geomid_ros.session.configuration import Configuration

    with needing_ros("playing a bag"):
        from geomid_ros.ros.player import play as published
    sensors = Configuration.read(config).sensors if config else []
    named = [*topic, *(sensor.topic for sensor in sensors)]
    count = 0
    with progress_bar() as progress:
        progress(f"playing {bag.name}", 0.0)
        for count, total in published(bag, rate, wait, named, lambda said: click.echo(printable(said), err=True)):
            progress(f"playing {bag.name}", count / total)
    click.echo(f"Published {count} messages of {bag}")
