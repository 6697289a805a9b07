"""``geomid compare``: what differs between two results."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import CompareOptions
from geomid_ros.commands.options import OUT, PATH, options_of
from geomid_ros.commands.terminal import plain_table, print_remarks, progress_bar, results_console, say


@click.command()
@click.argument("first", type=PATH)
@click.argument("second", type=PATH)
@options_of(CompareOptions)
@click.option("--out", default=Path("geomid_compare"), **OUT)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON instead of a table.")
def compare(out: Path, as_json: bool, **options: Any) -> None:
    """Compare two results of one robot.

    FIRST and SECOND are an estimate.json each, or one of them a URDF. Prints what differs by more than the joint 95 %
    intervals, and the errors of both side by side; writes all of it as compare.html. The exit status is that of the
    worse verdict of the two.
    """

    with progress_bar() as progress:
        found = geomid_ros.compare(progress=progress, **options)
    page = found.report(out / "compare.html")
    if as_json:
        click.echo(json.dumps(found.document, indent=2))
    else:
        _show(found)
        click.echo(f"\nWritten: {page}")
    sys.exit(found.status)


def _show(found: geomid_ros.Comparison) -> None:
    """Print whether the results differ, and a table of what differs and of the errors of both."""
    from geomid_ros.report.result_pages import error, row, verdict

    console = results_console()
    print_remarks(console, {"DOUBTFUL": found.doubts, "Note": found.notes})
    for number, path in enumerate((found.first, found.second), 1):
        say(console, f"{number}:", f" {path}")
    say(console, "", verdict(found.compared))
    table = plain_table("", ["where", "parameter"], ["1", "2", "difference"])
    for difference in found.differing:
        table.add_row(*row(difference))
    table.add_section()
    for channel in found.errors:
        unit = f" [{channel.unit}]" if channel.unit else ""
        table.add_row(channel.name, f"RMS error{unit}", error(channel.first), error(channel.second), "")
    console.print(table)
    say(console, "±:", " the 95 % interval of a value, the joint 95 % interval of a difference")
    if found.errors:
        say(console, "RMS errors:", f" on {found.judged_on}")
    for name in found.compared.not_compared:
        say(console, "Not compared:", f" {name}, identified together with other links in the second")
