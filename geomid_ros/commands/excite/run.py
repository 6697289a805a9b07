"""``geomid excite run``: a motion on a robot, watched over and recorded."""

from __future__ import annotations

import shlex
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import click

from geomid_ros.commands.options import PATH, UNTRIED_OUT, options_of
from geomid_ros.commands.terminal import plain_table, results_console, say
from geomid_ros.errors import needing_ros, printable
from geomid_ros.session.options import DescriptionOptions, RunOptions

if TYPE_CHECKING:
    from geomid_ros.ros.excite.run import Order, Plan


execute_option = click.option("--execute", is_flag=True, help="Move the robot; without it nothing moves.")


@click.command()
@click.argument("trajectory", type=PATH)
@click.option("--urdf", type=PATH, help="Robot description, URDF or .xacro.  [default: the topic robot_description]")
@click.option(
    "--speed",
    default=0.2,
    show_default=True,
    type=click.FloatRange(0.0, 1.0, min_open=True),
    help="Factor on the speed of the motion; raise it once nothing is in the way.",
)
@options_of(RunOptions)
@execute_option
@click.option("--identify", is_flag=True, help="Identify the robot from the recording afterwards.")
@click.option("--out", default=Path("geomid_out/excite"), **UNTRIED_OUT)
def run(
    *, trajectory: Path, urdf: Path | None, speed: float, execute: bool, identify: bool, out: Path, **options: Any
) -> None:
    """Run a motion on a robot, and record it.

    Reads TRAJECTORY, as written by 'geomid excite', and prints the plan. With --execute the robot moves slowly to the
    start on a collision-free path, then runs the motion, by default at a fifth of its speed. It stops on Ctrl-C, if a
    joint is off its trajectory, leaves its range or exceeds its effort limit, and if joint states stop. Obstacles that
    --avoid does not name are unknown: keep the emergency stop at hand. Needs ROS 2.
    """
    from geomid_ros.api.robot import description
    from geomid_ros.files.disk import check_writable
    from geomid_ros.files.trajectories import read_trajectory

    if execute:
        check_writable(out)
    ros = ros_runs()
    robot = description(DescriptionOptions(urdf), []) if urdf else None
    order = ros.Order(
        motion=read_trajectory(trajectory),
        source=str(trajectory),
        speed=speed,
        urdf=(robot.text, robot.source) if robot else None,
        options=RunOptions(**options),
    )
    with ros.prepared_run(order) as prepared:
        show_plan(order, prepared.plan)
        if not execute:
            click.echo("\nNothing has moved. To run it, add --execute")
            return
        bag = _free(out)
        prepared.execute(bag, lambda said: click.echo(printable(said), err=True))
    click.echo(f"Recorded: {bag}")
    _identify(bag, identify)


def ros_runs() -> ModuleType:
    """What runs motions. Raises InputError where there is no ROS."""
    with needing_ros("running a motion"):
        from geomid_ros.ros.excite import run
    return run


def show_plan(order: Order, plan: Plan) -> None:
    """What would be done."""
    from geomid_ros.report.gap_words import percent

    console = results_console()
    headings = ["now", "start", "distance", "lowest", "highest", "speed", "of its limit"]
    table = plain_table(f"{order.source} on {order.options.controller}", ["joint"], headings)
    motion, here = plan.motion, plan.way.positions[0]
    for index, joint in enumerate(motion.joints):
        positions, speed = motion.positions[:, index], motion.speeds[index]
        numbers = (here[index], positions[0], positions[0] - here[index], positions.min(), positions.max(), speed)
        share = percent(speed / plan.limits.speeds[index])
        table.add_row(joint, *(f"{number:.3f}" for number in numbers), share)
    console.print(table)
    far = max(abs(plan.way.positions[-1] - here))
    for note in plan.notes:
        say(console, "Note:", f" {note}")
    console.print(
        f"Approach: {far:.3f} rad (m) to the start, in {plan.way.duration:.1f} s. Motion: {motion.duration:.1f} s at "
        f"{100.0 * order.speed:g} % of its speed, at most {max(motion.speeds):.3f} rad/s (m/s).\n"
        f"It stops on Ctrl-C, if a joint is {order.options.tolerance:g} rad (m) off its trajectory, at the URDF's "
        f"limits of positions and efforts, and after {1e3 * plan.silence:.0f} ms without joint states."
    )


def _free(out: Path) -> Path:
    """The first folder run1, run2 ... that is not there yet."""
    number = 1
    while (out / f"run{number}").exists():
        number += 1
    return out / f"run{number}"


def _identify(bag: Path, at_once: bool) -> None:
    """Identify from a recording, or say how."""
    arguments = [str(bag), "--out", str(bag.with_name(f"{bag.name}_identified"))]
    if not at_once:
        click.echo(f"Next: geomid identify {shlex.join(arguments)}")
        return
    from geomid_ros.commands.recordings import identify

    identify.main(arguments, prog_name="geomid identify", standalone_mode=False)
