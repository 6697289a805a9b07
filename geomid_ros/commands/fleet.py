"""``geomid fleet``: many bags of many robots."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import FleetOptions
from geomid_ros.commands.options import OUT, options_of
from geomid_ros.commands.terminal import lines, plain_table, print_remarks, progress_bar, results_console


@click.command()
@click.argument("bags")
@options_of(FleetOptions)
@click.option("--out", default=Path("geomid_fleet"), **OUT)
def fleet(bags: str, out: Path, **options: Any) -> None:
    """Identify many robots of a type from many bags.

    BAGS is a folder with a subfolder of bags for each robot, a pattern, or a table (.csv) with the columns 'robot' and
    'bag'; on a disk, or at a URL such as s3://. Each bag is read once, on this machine or on a Dask cluster.
    Intermediate results are kept, so a second run reads only new bags. Every robot gets a folder with estimate.json,
    identified.urdf and posterior.npz. fleet.html lists the robots that differ from the others or have changed, and the
    bad bags. 'geomid identify --prior' starts a new robot from population.json.
    """
    with progress_bar() as progress:
        found = geomid_ros.identify_fleet(bags, out=out, progress=progress, **options)
    _show(found)
    sys.exit(found.status)


def _show(found: geomid_ros.FleetIdentification) -> None:
    """Print a table of the robots, and the bags that were bad."""
    console = results_console()
    table = plain_table(f"{len(found.lines)} robots", ["robot"], ["bags", "mass [kg]", "distance"])
    for heading in ("verdict", "differs from the others", "changed"):
        table.add_column(heading)
    for line in found.lines:
        numbers = ("" if number is None else f"{number:.2f}" for number in (line.mass, line.distance))
        remarks = (line.verdict, lines(line.unlike), lines(line.changed))
        table.add_row(line.name, f"{line.used} of {line.bags}", *numbers, *remarks)
    console.print(table)
    for line in found.lines:
        print_remarks(console, {line.name: line.reasons})
    print_remarks(
        console,
        {
            "Bad bag": [why if bag in why else f"{bag}: {why}" for bag, why in found.bad],
            "Doubtful bag": [f"{bag}: {what}" for bag, what in found.doubtful],
        },
    )
    console.print(f"\nWritten: {', '.join(map(str, found.files))}")
