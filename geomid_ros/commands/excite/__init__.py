"""``geomid excite``: exciting trajectories. Without a subcommand it designs one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

import geomid_ros
from geomid_ros.commands.excite.run import learn, run
from geomid_ros.commands.options import UNTRIED_OUT, options_of, share
from geomid_ros.commands.terminal import plain_table, print_remarks, progress_bar, results_console, say
from geomid_ros.session.options import MotionOptions

if TYPE_CHECKING:
    from geomid_ros.excitation.belief import ExpectedUncertainty
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


excite.add_command(run)
excite.add_command(learn)


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
