"""``geomid compare``: what differs between two results."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import OUT, PATH, robot_options


@click.command()
@click.argument("first", type=PATH)
@click.argument("second", type=PATH)
@robot_options
@click.option(
    "--bag",
    multiple=True,
    type=PATH,
    help="Bag that both models predict; may be repeated.  [default: the held-out data of each]",
)
@click.option("--out", default=Path("geomid_compare"), **OUT)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON instead of a table.")
def compare(out: Path, as_json: bool, **options: Any) -> None:
    """Compare two results of one robot.

    FIRST and SECOND are an estimate.json each, or one of them a URDF. Prints what differs by more than the joint 95 %
    intervals, and the errors of both side by side; writes all of it as compare.html. The exit status is that of the
    worse verdict of the two.
    """
    from geomid_ros.commands.results.tables import show_comparison
    from geomid_ros.commands.terminal import progress_bar

    with progress_bar() as progress:
        found = geomid_ros.compare(progress=progress, **options)
    page = found.report(out / "compare.html")
    if as_json:
        click.echo(json.dumps(found.document, indent=2))
    else:
        show_comparison(found)
        click.echo(f"\nWritten: {page}")
    sys.exit(found.status)
