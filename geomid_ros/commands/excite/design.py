"""What ``geomid excite`` does without a subcommand: design a motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.excite.options import motion_options, numbers, share_of
from geomid_ros.commands.options import UNTRIED_OUT


def design_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options of a design."""
    for option in (
        click.option("--out", default=Path("geomid_excite"), **UNTRIED_OUT),
        click.option(
            "--until",
            metavar="SHARE",
            callback=share_of,
            help="Write nothing if the motion would lower the expected error by less than this, e.g. 5%.",
        ),
        click.option(
            "--settle",
            type=click.Path(path_type=Path),
            help="Discriminate between the rival effects of this gap.json.",
        ),
        motion_options,
    ):
        command = option(command)
    return command


def design(*, start: str | None, until: float, out: Path, **options: Any) -> None:
    """Design a motion, print what to expect of it, and write it."""
    from geomid_ros.commands.progress import progress_bar
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
