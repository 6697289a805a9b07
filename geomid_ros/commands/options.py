"""Options that commands which read bags share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

URDF: dict[str, Any] = {"type": click.Path(path_type=Path), "help": "The robot's description."}
OUT: dict[str, Any] = {
    "type": click.Path(path_type=Path, file_okay=False),
    "show_default": True,
    "help": "Folder for results.",
}


def recording_options(command: Any) -> Any:
    """The options that say what is measured on the robot, which data are tested on, and where to start from."""
    for option in (
        click.option(
            "--validate", multiple=True, type=click.Path(path_type=Path), help="A bag to test on; may be repeated."
        ),
        click.option(
            "--hold-out",
            type=click.FloatRange(0.0, 0.9),
            help="Share of each bag's time, at the end, kept to test on.  [default: 0.3, with --validate 0]",
        ),
        click.option("--odom-topic", default="odom", show_default=True, help="Topic of the base's pose."),
        click.option("--joint-topic", default="joint_states", show_default=True, help="Topic of the joint states."),
        click.option(
            "--wrench",
            multiple=True,
            metavar="TOPIC:FRAME:ROLE[:AXES]",
            help="A wrench topic; ROLE is mounted or external, -ROLE reverses its sign; AXES like fz,tx,ty.",
        ),
        click.option("--floating-base", is_flag=True, help="The base moves; its pose is read from the odometry topic."),
        click.option("--model", type=click.Path(path_type=Path), help="Start from this estimate.json."),
        click.option("--config", type=click.Path(path_type=Path), help="The node's parameter file (YAML)."),
    ):
        command = option(command)
    return command
