"""``geomid simulate``: a rosbag of a simulated robot in MuJoCo with known parameters and hidden effects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from geomid_ros.commands.options import Names, Output, options_of
from geomid_ros.commands.terminal import progress_bar
from geomid_ros.errors import InputError
from geomid_ros.simulation.description import WRIST_FRAME, robot_names
from geomid_ros.simulation.effect_sizes import SIZES
from geomid_ros.simulation.options import LINK_MASS, NOTHING, Hidden, SimulationOptions, parse_hidden

if TYPE_CHECKING:
    from geomid_ros.simulation.recording import SimulationResult

_SAID = ParameterSource.COMMANDLINE
_OF_WALKS = ("robot", "duration", "rate", "seed", "motion_seed", "inertia_error")
_HIDE = f"""\b
Hide a physical effect; may be repeated:
  --hide spring                               random joint and size
  --hide coulomb_friction:joint2              random size
  --hide coulomb_friction:joint2=4.5          value of its first parameter
  --hide spring:joint2=stiffness=20,equilibrium=0.3
  --hide payload:tool=mass=1.2                at a link
  --hide {LINK_MASS}:tool=1.2                   a link's mass times 1.2 (--realistic)
  --hide {NOTHING}                              no effect at all."""


@click.command(
    epilog=f"Effects: {', '.join(SIZES)}. For an unknown joint or parameter, the error lists the valid ones."
)
@click.argument("out", type=Output(within=True))
@click.option(
    "--robot", default=SimulationOptions.robot, show_default=True, help=f"{', '.join(robot_names())}, or a URDF file."
)
@click.option("--hide", "hide", multiple=True, metavar="EFFECT[:PLACE][=VALUE]", help=_HIDE)
@click.option("--wrench", is_flag=True, help=f"Record a wrench sensor mounted at {WRIST_FRAME}.")
@click.option("--wrench-frame", metavar="LINK", help="Link of the sensor in another robot; implies --wrench.")
@options_of(SimulationOptions)
@click.option(
    "--feet",
    type=Names(),
    metavar="LINK:RADIUS,...",
    help="The robot is a quadruped that sways, lifts its legs and trots on these round feet [m], with an IMU, and a "
    "payload that its URDF lacks; needs a URDF file.",
)
@click.option("--imu", metavar="LINK", help="Link of the IMU of a robot with feet.")
def simulate(
    out: Path,
    hide: tuple[str, ...],
    wrench: bool,
    wrench_frame: str | None,
    feet: list[str] | None,
    imu: str | None,
    **options: Any,
) -> None:
    """Record a rosbag of a simulated robot.

    Writes the rosbag OUT, and the true parameters into OUT.truth.json. The bag contains the nominal URDF. The simulated
    robot has other inertias, and friction, rotor inertia and offsets at every joint; with --hide, only the named
    effects. Needs MuJoCo (pip install mujoco).
    """
    from geomid_ros.simulation.recording import simulate as record

    if feet or imu:
        context = click.get_current_context()
        given = {name: value for name, value in context.params.items() if name not in ("out", "feet", "imu")}
        explicit = {name: value for name, value in given.items() if context.get_parameter_source(name) is _SAID}
        click.echo(_walked(out, feet or [], imu or "", explicit))
        return
    frame = wrench_frame or (WRIST_FRAME if wrench else None)
    chosen = SimulationOptions(hide=_requests(hide), wrench_frame=frame, **options)
    with progress_bar() as progress:
        result = record(out, chosen, lambda share: progress(f"simulating {chosen.duration:g} s", share))
    click.echo(_written(result, bool(hide)))


def _walked(out: Path, feet: list[str], imu: str, options: dict[str, Any]) -> str:
    """Record a robot with feet, and return a message with the written files."""
    from geomid_ros.simulation.walking import WalkOptions, parse_feet, simulate_walk

    if not (feet and imu and "robot" in options):
        raise InputError("a robot that walks needs --feet, --imu and --robot, its URDF file")
    unknown = [f"--{name.replace('_', '-')}" for name in options if name not in _OF_WALKS]
    if unknown:
        raise InputError(f"{', '.join(unknown)}: not for a robot that walks; leave it out")
    bag, truth = simulate_walk(out, WalkOptions(feet=parse_feet(feet), imu=imu, **options))
    return f"Written: {bag}\n         {truth} (the true links)"


def _requests(texts: tuple[str, ...]) -> tuple[Hidden, ...] | None:
    """Parse the effects to hide; None if no effect is given, empty for ``nothing``."""
    return tuple(parse_hidden(text) for text in texts if text != NOTHING) if texts else None


def _written(result: SimulationResult, hidden: bool) -> str:
    content = "the hidden effects" if hidden else "the true parameters"
    lines = [f"Written: {result.bag} ({result.samples} messages per topic)", f"         {result.truth} ({content})"]
    if result.controller is not None:
        lines.append(f"         {result.controller} (the controller's gains)")
    return "\n".join(lines)
