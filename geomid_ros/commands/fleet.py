"""``geomid fleet``: many bags of many robots."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from geomid_ros.commands.options import OUT, robot_options


@click.command()
@click.argument("bags")
@robot_options
@click.option("--by", default="robot", show_default=True, help="Column of the table that names the robot.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Dask cluster.  [default: the cores of this machine]")
@click.option(
    "--hold-out",
    type=click.FloatRange(0.0, 0.9),
    help="Share of each bag, at its end, held out for testing.  [default: 0.3]",
)
@click.option(
    "--since",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of an earlier run, to report which robots have changed.",
)
@click.option(
    "--keep",
    metavar="FOLDER|URL",
    help="Where workers store intermediate results.  [default: the folder 'kept' in --out]",
)
@click.option("--out", default=Path("geomid_fleet"), **OUT)
def fleet(bags: str, out: Path, **options: Any) -> None:
    """Identify many robots of a type from many bags.

    BAGS is a folder with a subfolder of bags for each robot, a pattern, or a table (.csv) with the columns 'robot' and
    'bag'; on a disk, or at a URL such as s3://. Each bag is read once, on this machine or on a Dask cluster.
    Intermediate results are kept, so a second run reads only new bags. Every robot gets a folder with estimate.json,
    identified.urdf and posterior.npz. fleet.html lists the robots that differ from the others or have changed, and the
    bad bags. 'geomid identify --prior' starts a new robot from population.json.
    """
    from geomid_ros.api.fleet import identify_fleet
    from geomid_ros.commands.results.tables import show_fleet
    from geomid_ros.commands.terminal import progress_bar

    with progress_bar() as progress:
        found = identify_fleet(bags, out=out, progress=progress, **options)
    show_fleet(found)
    sys.exit(found.status)
