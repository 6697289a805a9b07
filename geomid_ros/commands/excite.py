"""``geomid excite``: exciting trajectories. Without a subcommand it designs one; ``run`` runs a monitored motion on a
robot and records it; ``learn`` identifies a robot from its URDF in rounds."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

import geomid_ros
from geomid_ros.commands.options import OUT, PATH, UNTRIED_OUT, options_of, share
from geomid_ros.commands.terminal import plain_table, print_remarks, progress_bar, results_console, say
from geomid_ros.errors import GeomidError, InputError, needing_ros, printable
from geomid_ros.session.options import DescriptionOptions, MotionOptions, RunOptions

if TYPE_CHECKING:
    from geomid_ros.api.robot import DescribedRobot
    from geomid_ros.excitation.belief import ExpectedUncertainty
    from geomid_ros.ros.excite import MotionRequest, Plan
    from geomid_ros.session.configuration import Configuration
    from geomid_ros.session.excitation import Excitation

_MOTIONS = ("before", "designed", "random", "designed,\ntwice")


@click.group(invoke_without_command=True)
@options_of(MotionOptions)
@click.option(
    "--until",
    metavar="SHARE",
    callback=share,
    help="Write nothing if the motion would lower the expected error by less than this, e.g. 5%.",
)
@click.option("--out", default=Path("geomid_excite"), **UNTRIED_OUT)
@click.pass_context
def excite(context: click.Context, /, until: float, out: Path, **options: Any) -> None:
    """Design an exciting trajectory.

    Writes an informative trajectory that is feasible at every instant: within the limits of position, speed,
    acceleration and jerk, within the effort limits with a margin for uncertain inertias, and with a clearance between
    all links and obstacles. It begins and ends at rest.
    """
    if context.invoked_subcommand is not None:
        return
    from geomid_ros.files.disk import check_writable

    check_writable(out)
    with progress_bar() as progress:
        design = geomid_ros.excite(progress=progress, **options)
        worth_it = design.excitation.learning.gain >= until
        progress("writing", 0.0)
        files = design.save(out) if worth_it else []
    _show(design.excitation)
    no = f"Nothing was written: {design.excitation.not_worth(until)}"
    click.echo(f"\nWritten: {', '.join(map(str, files))}" if worth_it else f"\n{no}")


def _show(design: Excitation) -> None:
    """Print notes, margins and expected standard deviations."""
    console = results_console()
    print_remarks(console, {"Note": design.task.notes})
    form = design.motion.form
    console.print(f"{form.repeats} x {form.period:g} s = {form.duration:g} s")
    console.print(_margins(design))
    if design.closest:
        say(console, "Smallest distance:", f" {design.closest}")
    console.print(_links(design))
    if design.task.belief.posterior.effects:
        console.print(_effects(design))
    for decision in design.decisions:
        say(console, "Discriminates:" if decision.is_sure else "Does not discriminate:", f" {decision.sentence}")
    say(console, "Expected", f" {design.error}:")
    for sentence in design.learning.sentences:
        say(console, "", f"- {sentence}")


def _margins(design: Excitation) -> Table:
    from geomid_ros.report.gap_words import percent

    headings = ["lowest", "highest", "to limit", "speed", "acceleration", "jerk", "effort with margin"]
    table = plain_table("Use of each limit", ["joint"], headings)
    margins, positions = design.margins, design.trajectory.positions
    for index, name in enumerate(design.task.feasibility.names):
        used = (margins.velocity, margins.acceleration, margins.jerk, margins.effort)
        ends = positions[:, index].min(), positions[:, index].max(), margins.position[index]
        numbers = (*(f"{end:.3f}" for end in ends), *(percent(share[index]) for share in used))
        table.add_row(name, *numbers)
    return table


def _links(design: Excitation) -> Table:
    table = plain_table("Standard deviation of the mass [kg]", ["link"], ["mass", *_MOTIONS])
    masses = design.task.belief.posterior.parameters
    for index, name in enumerate(design.task.belief.posterior.links):
        stds = (f"{stage.links[index, 0]:.2g}" for stage in _stages(design))
        table.add_row(name, f"{masses[10 * index]:.3f}", *stds)
    return table


def _effects(design: Excitation) -> Table:
    from geomid_ros.model.effects import EFFECTS
    from geomid_ros.report.gap_words import headline

    table = plain_table("Standard deviation of the effects", ["effect", "at"], _MOTIONS, ["unit"])
    for index, effect in enumerate(design.task.belief.posterior.effects):
        parameter = "" if EFFECTS[effect.name].is_one_number() else f" {effect.parameter}"
        stds = (f"{stage.effects[index]:.2g}" for stage in _stages(design))
        table.add_row(headline(effect.name) + parameter, effect.place, *stds, effect.unit)
    return table


def _stages(design: Excitation) -> tuple[ExpectedUncertainty, ...]:
    """Expected uncertainties, in the order of the tables' columns."""
    learning = design.learning
    return learning.before, learning.designed, learning.random, learning.twice


# --- On a robot ---

execute_option = click.option("--execute", is_flag=True, help="Move the robot; without it nothing moves.")


@excite.command()
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
    robot = description(DescriptionOptions(urdf), []) if urdf else None
    folders = (out / f"run{number}" for number in count(1))
    bag = next(folder for folder in folders if not folder.exists()) if execute else None
    _run_motion(
        bag,
        motion=read_trajectory(trajectory),
        source=str(trajectory),
        speed=speed,
        urdf=(robot.text, robot.source) if robot else None,
        options=RunOptions(**options),
    )
    if bag is not None:
        click.echo(f"Recorded: {bag}")
        _identify(bag, identify)


def _run_motion(bag: Path | None, **motion: Any) -> None:
    """Print the plan of a motion; with a ``bag``, move the robot and record into it.

    Args:
        bag: folder of the recording.
        **motion: attributes of :class:`~geomid_ros.ros.excite.MotionRequest`.

    Raises:
        GeomidError: the motion is impossible, it was stopped, or ROS is not installed.
    """
    with needing_ros("running a motion"):
        from geomid_ros.ros.excite import MotionRequest, prepared_run
    order = MotionRequest(**motion)
    with prepared_run(order) as prepared:
        _show_plan(order, prepared.plan)
        if bag is None:
            click.echo("\nNothing has moved. To run it, add --execute")
        else:
            prepared.execute(bag, lambda line: click.echo(printable(line), err=True))


def _show_plan(order: MotionRequest, plan: Plan) -> None:
    """Print the plan of a motion."""
    from geomid_ros.report.gap_words import percent

    console = results_console()
    headings = ["now", "start", "distance", "lowest", "highest", "speed", "of its limit"]
    table = plain_table(f"{order.source} on {order.options.controller}", ["joint"], headings)
    motion, current = plan.motion, plan.approach.positions[0]
    for index, joint in enumerate(motion.joints):
        positions, speed = motion.positions[:, index], motion.speeds[index]
        numbers = (current[index], positions[0], positions[0] - current[index], positions.min(), positions.max(), speed)
        share = percent(speed / plan.limits.speeds[index])
        table.add_row(joint, *(f"{number:.3f}" for number in numbers), share)
    console.print(table)
    far = max(abs(plan.approach.positions[-1] - current))
    print_remarks(console, {"Note": plan.notes})
    console.print(
        f"Approach: {far:.3f} rad (m) to the start, in {plan.approach.duration:.1f} s. "
        f"Motion: {motion.duration:.1f} s at {100.0 * order.speed:g} % of its speed, "
        f"at most {max(motion.speeds):.3f} rad/s (m/s).\n"
        f"It stops on Ctrl-C, if a joint is {order.options.tolerance:g} rad (m) off its trajectory, at the URDF's "
        f"limits of positions and efforts, and after {1e3 * plan.silence:.0f} ms without joint states."
    )


def _identify(bag: Path, at_once: bool) -> None:
    """Identify from a recording, or print the command for it."""
    arguments = [str(bag), "--out", str(bag.with_name(f"{bag.name}_identified"))]
    if not at_once:
        click.echo(f"Next: geomid identify {shlex.join(arguments)}")
        return
    from geomid_ros.commands.recordings import identify

    identify.main(arguments, prog_name="geomid identify", standalone_mode=False)


_FIRST = 0.2  # factor on the speed of the first round


@dataclass(frozen=True, kw_only=True)
class LearnOptions(MotionOptions, RunOptions):
    """Options for the design of all motions, and for running them."""


@excite.command()
@options_of(LearnOptions, without=("discriminate",))
@click.option(
    "--until",
    default="5%",
    show_default=True,
    metavar="SHARE",
    callback=share,
    help="Stop when another round would lower the expected error by less than this.",
)
@click.option("--rounds", default=10, show_default=True, type=click.IntRange(1), help="Largest number of rounds.")
@click.option("--yes", is_flag=True, help="Do not ask before each round.")
@execute_option
@click.option("--out", default=Path("geomid_out/learn"), **OUT)
def learn(*, until: float, rounds: int, yes: bool, execute: bool, out: Path, **options: Any) -> None:
    """Identify a robot in rounds: design, run, identify.

    Each round designs a trajectory for what is still uncertain, runs it, and identifies from all recordings so far.
    Stops when another round is not worth it (--until). Without --execute it only designs the first motion and prints
    the plan. The first motion is designed for a fifth of the speed. Asks before each round, and writes its motion,
    recording and result into a folder. Any stop of 'geomid excite run' ends the command, which then says how to
    continue. Needs ROS 2.
    """
    from geomid_ros.api.excite import robot_to_excite

    asked = LearnOptions(**options)
    robot, chosen = robot_to_excite(asked)
    if (out / "round1").exists():
        raise InputError(f"{out / 'round1'} exists already; name another folder with --out")
    learning = _LearningRounds(robot, chosen, asked, out)
    for _ in range(rounds):
        designed = learning.design()
        if learning.found and designed.learning.gain < until:
            click.echo(f"Stopped: {designed.not_worth(until)}")
            break
        learning.show(designed)
        question = f"Run this motion ({learning.folder / 'motion.html'} plays it)?"
        if execute and not yes and not click.confirm(question):
            click.echo(f"Round {learning.number} was not run")
            break
        learning.run(designed, execute=execute)
        if not execute:
            return
        learning.identify()
    else:
        click.echo(f"Stopped after {rounds} rounds (--rounds)")
    learning.tell()


@dataclass
class _LearningRounds:
    """Rounds of learning a ``robot``, with the state so far.

    Attributes:
        chosen: initial configuration.
        asked: options for the design of all motions, and for running them.
        out: folder of all rounds.
        number: number of the last round that was begun.
        identified: number of the last round whose recording was used.
        found: identification after that round.
    """

    robot: DescribedRobot
    chosen: Configuration
    asked: LearnOptions
    out: Path
    number: int = 0
    identified: int = 0
    found: geomid_ros.Identification | None = None

    @property
    def folder(self) -> Path:
        """Folder of the last round that was begun."""
        return self.out / f"round{self.number}"

    @property
    def result(self) -> Path:
        """Folder of the last identification."""
        return self.out / f"round{self.identified}"

    def design(self) -> Excitation:
        """Design the motion of the next round, given the identification so far."""
        from geomid_ros.api.excite import designed_motion

        speed, parameters = self.asked.speed, self.chosen
        if self.found is None:
            speed *= _FIRST
        else:
            parameters = parameters.with_values({"model": str(self.result / "estimate.json")})
        with progress_bar() as progress:
            asked = replace(self.asked, speed=speed, progress=progress)
            return designed_motion(self.robot, parameters, asked).excitation

    def show(self, designed: Excitation) -> None:
        """Begin a round: write its motion, and print its expected result."""
        from geomid_ros.report.excitation import save

        self.number += 1
        save(designed, self.folder)
        form = designed.motion.form
        click.echo(f"\nRound {self.number}: {form.repeats} x {form.period:g} s, in {self.folder}")
        for sentence in designed.task.notes if self.number == 1 else ():
            click.echo(printable(f"Note: {sentence}"))
        click.echo(f"Expected {designed.error}: {designed.learning.sentences[0]}")

    def run(self, designed: Excitation, *, execute: bool) -> None:
        """Print the plan; with ``execute``, move and record.

        Raises GeomidError with instructions to continue. Any stop ends the rounds, because it was unexpected and the
        robot must be inspected before it moves again.
        """
        try:
            _run_motion(
                self.folder / "recording" if execute else None,
                motion=designed.trajectory,
                source=str(self.folder / "trajectory.yaml"),
                speed=1.0,
                urdf=(self.robot.text, self.robot.source),
                options=self.asked,
            )
        except GeomidError as error:
            raise GeomidError(f"round {self.number}: {error}. {self._how_to_continue}") from error

    @property
    def _how_to_continue(self) -> str:
        """State the result so far after a stopped round, and how to continue."""
        if self.found is None:
            return "Nothing is identified yet. To start again, repeat the command with another --out"
        estimate = self.result / "estimate.json"
        return (
            f"The result so far is in {self.result}. To continue, repeat the command with --from {estimate} and "
            "another --out"
        )

    def identify(self) -> None:
        """Identify from all recordings."""
        bags = [self.out / f"round{number}" / "recording" for number in range(1, self.number + 1)]
        with progress_bar() as progress:
            self.found = geomid_ros.identify(
                bags,
                self.robot.text,
                config=self.chosen,
                joint_topic=self.asked.joint_topic,
                hold_out=0.0,
                progress=progress,
            )
            command = shlex.join(["geomid", *sys.argv[1:]])
            self.found.save(self.folder, progress=progress, command=command)
        self.identified = self.number
        masses = ", ".join(f"{link.name} {link.mass:.3f} ± {link.std_mass:.3f}" for link in self.found.links)
        click.echo(printable(f"Masses after round {self.number} [kg]: {masses}"))

    def tell(self) -> None:
        """Print the final result. Raises SystemExit with the verdict's status."""
        if self.found is None:
            return
        from geomid_ros.commands.recording_results import show_identification

        show_identification(self.found)
        click.echo(f"\nIdentified from {self.identified} rounds: {self.result / 'identified.urdf'}")
        sys.exit(self.found.verdict.status)
