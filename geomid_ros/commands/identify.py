"""``geomid identify``: link inertias from rosbags."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import IdentifyOptions
from geomid_ros.commands.options import OUT, PATH, options_of, report_option
from geomid_ros.errors import one_line


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
    from geomid_ros.commands import identify_results
    from geomid_ros.commands.terminal import print_written, progress_bar

    with progress_bar() as progress:
        found = geomid_ros.identify(bags, progress=progress, **options)
        files = found.save(out, report=report, progress=progress, command=shlex.join(["geomid", *sys.argv[1:]]))
    if as_json:
        click.echo(files[0].read_text(encoding="utf-8"), nl=False)
    else:
        identify_results.show(found)
        print_written(files, out, report=report)
        if found.not_written:
            click.echo(one_line(found.not_written))
    sys.exit(found.verdict.status)
