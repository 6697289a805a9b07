"""``geomid simulate``: a rosbag of a MuJoCo robot whose truth is known, with effects hidden in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomid_ros.commands.options import Output
from geomid_ros.simulation import (
    EFFECTS,
    LINK_MASS,
    MOTIONS,
    NOTHING,
    WRIST_FRAME,
    Hidden,
    SimulationOptions,
    parse_hidden,
    robot_names,
)

if TYPE_CHECKING:
    from geomid_ros.simulation import SimulationResult

_DEFAULT = SimulationOptions()
_HIDE = f"""\b
Hide a physical effect, alone or with others (repeat the option):
  --hide spring                               joint and size drawn
  --hide coulomb_friction:joint2              size drawn
  --hide coulomb_friction:joint2=4.5          its first parameter
  --hide spring:joint2=stiffness=20,equilibrium=0.3
  --hide payload:tool=mass=1.2                at a link
  --hide {LINK_MASS}:tool=1.2                   a link's mass times 1.2 (--realistic)
  --hide {NOTHING}                              no effect at all."""


@click.command(epilog=f"Effects: {', '.join(EFFECTS)}. An unknown joint or parameter is answered with those there are.")
@click.argument("out", type=Output(within=True))
@click.option("--robot", default=_DEFAULT.robot, show_default=True, help=f"{', '.join(robot_names())}, or a URDF file.")
@click.option("--hide", "hide", multiple=True, metavar="EFFECT[:PLACE][=VALUE]", help=_HIDE)
@click.option("--duration", default=_DEFAULT.duration, show_default=True, help="Seconds.")
@click.option("--rate", default=_DEFAULT.rate, show_default=True, help="Messages per second.")
@click.option("--seed", default=_DEFAULT.seed, show_default=True, help="Fixes the robot, its motion and the noise.")
@click.option(
    "--realistic",
    is_flag=True,
    help="A robot as robots are: friction that slips before it slides, cogging, ripple, gains a few per cent off, "
    "steps of encoders, stamps that jitter, lost messages.",
)
@click.option("--motion-seed", type=int, help="Another motion and noise of the same robot.")
@click.option(
    "--motion",
    type=click.Choice(MOTIONS),
    default=_DEFAULT.motion,
    show_default=True,
    help="Sines repeat themselves every --period.",
)
@click.option("--period", default=_DEFAULT.motion_period, show_default=True, help="Of the slowest sine, in seconds.")
@click.option(
    "--inertia-error", default=_DEFAULT.inertia_error, show_default=True, help="How far the truth is from the URDF."
)
@click.option("--wrench", is_flag=True, help=f"Record a wrench sensor mounted at {WRIST_FRAME}.")
@click.option("--wrench-frame", metavar="LINK", help="Where the sensor is in another robot; implies --wrench.")
@click.option("--wrench-lag", default=0.0, help="Sample (and stamp) the wrench so many seconds after the joints.")
@click.option("--commands", is_flag=True, help="Record the controller's set-points on /joint_commands, and its gains.")
@click.option(
    "--noise-time", default=_DEFAULT.noise_time, help="Time constant of coloured effort and wrench noise, in seconds."
)
@click.option("--position-step", default=_DEFAULT.position_step, help="Resolution of positions, in rad or m.")
@click.option("--effort-step", default=_DEFAULT.effort_step, help="Resolution of efforts, as a share of the limit.")
def simulate(
    out: Path, hide: tuple[str, ...], wrench: bool, wrench_frame: str | None, period: float, **options: Any
) -> None:
    """Record a simulated robot into a new rosbag.

    Writes the rosbag OUT, and what is true of the robot into OUT.truth.json. The bag holds the nominal URDF; the robot
    that moves has other inertias, and friction, rotor inertia and offsets at every joint, or with --hide nothing but
    what that says. Needs MuJoCo (pip install mujoco).
    """
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.simulation import simulate as record

    frame = wrench_frame or (WRIST_FRAME if wrench else None)
    chosen = SimulationOptions(hide=_requests(hide), wrench_frame=frame, motion_period=period, **options)
    with progress_bar() as progress:
        result = record(out, chosen, lambda share: progress(f"simulating {chosen.duration:g} s", share))
    click.echo(_written(result, bool(hide)))


def _requests(texts: tuple[str, ...]) -> tuple[Hidden, ...] | None:
    """None when nothing was said about effects; nothing to hide for ``nothing``."""
    return tuple(parse_hidden(text) for text in texts if text != NOTHING) if texts else None


def _written(result: SimulationResult, hidden: bool) -> str:
    what = "the answer, of which the bag has no trace" if hidden else "what is true of it"
    lines = [f"Written: {result.bag} ({result.samples} messages per topic)", f"         {result.truth} ({what})"]
    if result.controller is not None:
        lines.append(f"         {result.controller} (the controller's gains)")
    return "\n".join(lines)
