"""What ``geomid excite`` does without a subcommand: design a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from geomid_ros.commands.excite.options import motion_options, share_of, wish_of
from geomid_ros.commands.options import UNTRIED_OUT
from geomid_ros.errors import InputError


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


def design(
    *,
    urdf: Path | None,
    xacro_args: tuple[str, ...],
    model: Path | None,
    lock: list[str] | None,
    wrench: tuple[str, ...],
    settle: Path | None,
    until: float,
    out: Path,
    **options: Any,
) -> None:
    """Design a motion, print what to expect of it, and write it."""
    from geomid_ros.api.arguments import configuration, description
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.commands.results import excitation as results
    from geomid_ros.files.disk import check_writable
    from geomid_ros.report.excitation import save
    from geomid_ros.session import excitation

    check_writable(out)
    if urdf is None and model is None:
        raise InputError("no robot is given: add --urdf ROBOT.urdf (or --from estimate.json, with identified.urdf)")
    robot = description(urdf, [], model=model, xacro_args=xacro_args)
    chosen = configuration(None, model=model, floating_base=False, wrench=wrench, locked_joints=lock or [])
    asked = replace(wish_of(options), settle=settle)
    with progress_bar() as progress:
        task = excitation.task_of(robot.text, Path(robot.source), chosen, asked)
        found = excitation.design(task, asked, progress)
        worth_it = found.learning.gain >= until
        progress("writing", 0.0)
        files = save(found, out) if worth_it else []
    results.show(found)
    said = f"Written: {', '.join(map(str, files))}" if worth_it else f"Nothing was written: {found.not_worth(until)}"
    click.echo(f"\n{said}")
