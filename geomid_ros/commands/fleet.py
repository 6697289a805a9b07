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
@click.option("--by", default="robot", show_default=True, help="The column of a table of bags that names the robot.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="A Dask cluster.  [default: this machine's cores]")
@click.option(
    "--hold-out",
    type=click.FloatRange(0.0, 0.9),
    help="Share of each bag's time, at the end, kept to test on.  [default: 0.3]",
)
@click.option(
    "--since",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="The folder of an earlier run, to tell which robots have changed.",
)
@click.option(
    "--keep", metavar="FOLDER|URL", help="Where all workers keep what they did.  [default: the folder 'kept' in --out]"
)
@click.option("--out", default=Path("geomid_fleet"), **OUT)
def fleet(bags: str, out: Path, **options: Any) -> None:
    """Identify many robots of a type from many bags.

    BAGS is a folder with a folder of bags for each robot, a pattern, or a table (.csv) with the columns 'robot' and
    'bag'; on a disk, or by a URL as s3://. Each bag is read once, on this machine or on a Dask cluster; what was done
    is kept, and a second run does only what is new. Every robot gets a folder with estimate.json, identified.urdf and
    posterior.npz; fleet.html says which robots are unlike the others, which have changed and which bags were bad, and
    population.json is what 'geomid identify --prior' starts a new robot from.
    """
    from geomid_ros.api.fleet import identify_fleet
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.commands.results import fleet as results

    with progress_bar() as progress:
        found = identify_fleet(bags, out=out, progress=progress, **options)
    results.show(found)
    sys.exit(found.status)
