"""``geomid gap``: where simulation and measurement disagree, which effect that is, and the model with it."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import GapOptions
from geomid_ros.commands.options import OUT, PATH, options_of, report_option
from geomid_ros.commands.terminal import print_written, progress_bar


@click.command()
@click.argument("bags", nargs=-1, required=True, type=PATH)
@options_of(GapOptions)
@click.option("--out", default=Path("geomid_gap"), **OUT)
@report_option
@click.option("--json", "as_json", is_flag=True, help="Print gap.json instead of tables.")
def gap(bags: tuple[Path, ...], out: Path, report: bool, as_json: bool, **options: Any) -> None:
    """Diagnose the gap between simulation and robot.

    Compares BAGS (folders, folders of them, or .mcap and .db3 files) with the model of --urdf or --model. Names the
    missing effects, adds them to the model, and shows how much of the gap they close on held-out data. Writes
    gap.json, report.html, the model (estimate.json, identified.urdf, identified.xml (MJCF) and effects.yaml), and the
    description for --for. The exit status is 4 if the recording is doubtful, or if that description predicts a channel
    worse than the given one.
    """
    from geomid_ros.commands import gap_results
    from geomid_ros.files.models.gap_file import is_open

    with progress_bar() as progress:
        found = geomid_ros.find_gap(bags, progress=progress, **options)
        files = found.save(out, report=report, progress=progress)
    if as_json:
        click.echo(json.dumps(found.document, indent=2))
    else:
        gap_results.show(found)
        print_written(files, out, report=report)
        if is_open(found.result):
            arguments = ("--urdf", options["urdf"] or "ROBOT.urdf", "--settle", out / "gap.json")
            click.echo(f"To discriminate between the rivals: geomid excite {shlex.join(map(str, arguments))}")
    sys.exit(found.status)
