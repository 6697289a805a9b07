"""``geomid simulate``: a rosbag of a MuJoCo robot whose truth is known."""

from __future__ import annotations

from pathlib import Path

import click

from geomid_ros.commands.progress import progress_bar
from geomid_ros.simulation import WRIST_FRAME, SimulationOptions, robot_names
from geomid_ros.simulation import simulate as record

_DEFAULT = SimulationOptions()


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--robot", default=_DEFAULT.robot, show_default=True, help=f"{', '.join(robot_names())}, or a URDF file.")
@click.option("--duration", default=_DEFAULT.duration, show_default=True, help="Seconds.")
@click.option("--rate", default=_DEFAULT.rate, show_default=True, help="Messages per second.")
@click.option("--seed", default=_DEFAULT.seed, show_default=True, help="Fixes the robot, its motion and the noise.")
@click.option("--motion-seed", type=int, help="Another motion and noise of the same robot.")
@click.option(
    "--inertia-error", default=_DEFAULT.inertia_error, show_default=True, help="How far the truth is from the URDF."
)
@click.option("--wrench", is_flag=True, help=f"Record a wrench sensor mounted at {WRIST_FRAME}.")
def simulate(
    out: Path,
    robot: str,
    duration: float,
    rate: float,
    seed: int,
    motion_seed: int | None,
    inertia_error: float,
    wrench: bool,
) -> None:
    """Record a simulated robot into a new rosbag.

    Writes the rosbag OUT, and what is true of the robot into OUT.truth.json. The bag holds the nominal URDF; the robot
    that moves has other inertias, and friction. Needs MuJoCo (pip install mujoco).
    """
    options = SimulationOptions(
        robot=robot,
        seed=seed,
        motion_seed=motion_seed,
        duration=duration,
        rate=rate,
        inertia_error=inertia_error,
        wrench_frame=WRIST_FRAME if wrench else None,
    )
    with progress_bar() as bar:
        task = bar.add_task(f"simulating {duration:g} s", total=1.0)
        result = record(out, options, lambda share: bar.update(task, completed=share))
    click.echo(f"Written: {result.bag} ({result.samples} messages per topic), {result.truth}")
