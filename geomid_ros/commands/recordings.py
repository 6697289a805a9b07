"""``geomid identify``, ``gap`` and ``fleet``: commands on rosbags."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import OUT, PATH, options_of, report_option
from geomid_ros.session.options import FleetOptions, GapOptions, IdentifyOptions


@click.command()
@click.argument("bags", nargs=-1, required=True, type=PATH)
@options_of(IdentifyOptions)
@click.option("--out", default=Path("geomid_out"), **OUT)
@report_option
@click.option("--json", "as_json", is_flag=True, help="Print estimate.json instead of tables.")
def identify(bags: tuple[Path, ...], out: Path, report: bool, as_json: bool, **options: Any) -> None:
    """Identify link inertias from rosbags.

    Reads BAGS (folders, folders of them, or .mcap and .db3 files) and writes estimate.json, identified.urdf,
    effects.yaml, posterior.npz, identification.png, report.html, tables (CSV), and the description for --for. The
    result is tested on held-out data: the end of each bag, or the bags of --validate. The exit status is 4 if it is
    doubtful, for example if it predicts a channel worse than the given description. Where only the written file
    does, as it cannot hold all effects, a warning says so.
    """
    from geomid_ros.commands.recording_results import show_identification
    from geomid_ros.commands.terminal import print_written, progress_bar

    with progress_bar() as progress:
        result = geomid_ros.identify(bags, progress=progress, **options)
        files = result.save(out, report=report, progress=progress, command=shlex.join(["geomid", *sys.argv[1:]]))
    if as_json:
        click.echo(files[0].read_text(encoding="utf-8"), nl=False)
    else:
        show_identification(result)
        print_written(files, out, report=report)
    sys.exit(result.verdict.status)


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
    from geomid_ros.commands.recording_results import show_gap
    from geomid_ros.commands.terminal import print_written, progress_bar
    from geomid_ros.files.models.gap_file import is_open

    with progress_bar() as progress:
        result = geomid_ros.find_gap(bags, progress=progress, **options)
        files = result.save(out, report=report, progress=progress)
    if as_json:
        click.echo(json.dumps(result.document, indent=2))
    else:
        show_gap(result)
        print_written(files, out, report=report)
        if is_open(result.result) and not result.session.robot.floating_base:
            arguments = ("--urdf", options["urdf"] or "ROBOT.urdf", "--discriminate", out / "gap.json")
            click.echo(f"For a motion that tells what is still open: geomid excite {shlex.join(map(str, arguments))}")
    sys.exit(result.status)


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
    from geomid_ros.commands.recording_results import show_fleet
    from geomid_ros.commands.terminal import progress_bar

    with progress_bar() as progress:
        result = geomid_ros.identify_fleet(bags, out=out, progress=progress, **options)
    show_fleet(result)
    sys.exit(result.status)
