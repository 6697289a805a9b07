"""``geomid excite``: motions that tell what a robot weighs. Without a subcommand it designs one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.excite.learn import learn
from geomid_ros.commands.excite.options import motion_options, numbers, share_of
from geomid_ros.commands.excite.run import run
from geomid_ros.commands.options import PATH, UNTRIED_OUT
from geomid_ros.commands.terminal import progress_bar


@click.group(invoke_without_command=True)
@motion_options
@click.option("--settle", type=PATH, help="Discriminate between the rival effects of this gap.json.")
@click.option(
    "--until",
    metavar="SHARE",
    callback=share_of,
    help="Write nothing if the motion would lower the expected error by less than this, e.g. 5%.",
)
@click.option("--out", default=Path("geomid_excite"), **UNTRIED_OUT)
@click.pass_context
def excite(context: click.Context, /, start: str | None, until: float, out: Path, **options: Any) -> None:
    """Design an exciting trajectory.

    Writes an informative trajectory that is feasible at every instant: within the limits of position, speed,
    acceleration and jerk, within the effort limits with a margin for uncertain inertias, and with a clearance between
    all links and obstacles. It begins and ends at rest.
    """
    if context.invoked_subcommand is not None:
        return
    from geomid_ros.commands.results import excitation as results
    from geomid_ros.files.disk import check_writable

    check_writable(out)
    with progress_bar() as progress:
        found = geomid_ros.excite(start=numbers(start), progress=progress, **options)
        worth_it = found.excitation.learning.gain >= until
        progress("writing", 0.0)
        files = found.save(out) if worth_it else []
    results.show(found.excitation)
    no = f"Nothing was written: {found.excitation.not_worth(until)}"
    click.echo(f"\nWritten: {', '.join(map(str, files))}" if worth_it else f"\n{no}")


excite.add_command(run)
excite.add_command(learn)
