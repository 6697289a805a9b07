"""``geomid feedforward``: a trajectory with the efforts that an identified robot takes for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

import geomid_ros
from geomid_ros.api.options import FeedforwardOptions
from geomid_ros.commands.options import PATH, Output, options_of
from geomid_ros.commands.terminal import plain_table, print_remarks, results_console


@click.command()
@click.argument("trajectory", type=PATH)
@click.option("--model", type=PATH, help="An estimate.json.  [default: the URDF alone]")
@options_of(FeedforwardOptions, without=("wrench",))
@click.option(
    "--out",
    type=Output(within=True),
    default=Path("trajectory_ff.yaml"),
    show_default=True,
    help="Where it goes: .yaml, .csv, or a folder for a rosbag.",
)
def feedforward(out: Path, **options: Any) -> None:
    """Fill the efforts of a trajectory.

    TRAJECTORY is a trajectory_msgs/JointTrajectory with velocities: YAML, as 'geomid excite' writes and 'ros2 topic
    echo' prints it (also of MoveIt's messages), or a rosbag. It comes back with the efforts of the identified model at
    every point, in the unit of the robot's messages, for a controller that adds them to its feedback, as the
    joint_trajectory_controller does. The motion stays what it is; points are added on it where the efforts need them.
    Refuses a trajectory that takes more effort than the URDF allows, and a model whose verdict is not 'usable'.
    """

    found = geomid_ros.feedforward(**options)
    found.save(out)
    _show(found)
    click.echo(f"\nWritten: {out}")


def _show(found: geomid_ros.Feedforward) -> None:
    """Print notes, and the efforts of each joint of a trajectory."""
    console, trajectory = results_console(), found.trajectory
    print_remarks(console, {"Note": found.notes})
    console.print(f"{trajectory.duration:g} s, {len(trajectory.times)} points ({found.given} were given)")
    headings = ["RMS", "largest", "limit", "interpolation error"]
    table = plain_table("Efforts of the motors [N m, N]", ["joint"], headings)
    rms = np.sqrt(np.mean(trajectory.efforts**2, axis=0))
    for joint, *numbers in zip(trajectory.joints, rms, found.largest, found.limits, found.errors, strict=True):
        table.add_row(joint, *(f"{number:.4g}" if np.isfinite(number) else "-" for number in numbers))
    console.print(table)
