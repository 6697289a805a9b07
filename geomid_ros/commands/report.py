"""``geomid report``: the page of a result again, from its files."""

from __future__ import annotations

from pathlib import Path

import click

import geomid_ros
from geomid_ros.commands.options import OUT, PATH


@click.command()
@click.argument("folder", type=PATH)
@click.option("--out", **OUT | {"help": "Folder for the page and the tables.  [default: FOLDER]"})
def report(folder: Path, out: Path | None) -> None:
    """Write the report of a result again.

    Reads the files that 'geomid identify' or 'geomid gap' wrote into FOLDER, and writes report.html and the tables
    (CSV) from them. The recordings are not needed; without them the page has no time series, and says so.
    """
    files = geomid_ros.rebuild_report(folder, out=out)
    click.echo(f"Written: {', '.join(map(str, files))}")
