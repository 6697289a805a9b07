"""``geomid sample``: robots drawn from what an identification knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import SampleOptions
from geomid_ros.commands.options import OUT, PATH, options_of
from geomid_ros.commands.terminal import plain_table, progress_bar, results_console
from geomid_ros.errors import one_line
from geomid_ros.exports.formats import JSON
from geomid_ros.files.models.readers import DESCRIBED_FOR


@click.command()
@click.argument("model", metavar="ESTIMATE", type=PATH)
@click.option(
    "--for", "tool", required=True, type=click.Choice([*DESCRIBED_FOR, JSON]), help="Software that will read them."
)
@options_of(SampleOptions)
@click.option("--out", default=Path("geomid_samples"), **OUT)
def sample(out: Path, **options: Any) -> None:
    """Sample robots from the posterior.

    ESTIMATE is an estimate.json; identified.urdf and posterior.npz of the same run must be in its folder. Links and
    effects are sampled jointly, and every robot is physically consistent. Writes a description of each robot as 'geomid
    export' does (json: one robots.json). Also writes ranges.yaml with the 95 % range of each number (for isaac with the
    event terms of Isaac Lab), and torques.png, which compares the spread of joint torques with that of ranges of 20 %.
    """

    found = geomid_ros.sample(**options)
    for heading, sentence in (("Warning", found.drawn.model.doubt), ("Note", found.drawn.not_drawn)):
        if sentence:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    with progress_bar() as progress:
        *robots, ranges, picture = found.save(out, progress=progress)
    _show(found)
    files = f"{robots[0]} to {robots[-1].name}" if len(robots) > 1 else str(robots[0])
    click.echo(f"\nWritten: {files}, {ranges}, {picture}")


def _show(found: geomid_ros.SampledRobots) -> None:
    """Print how much torques differ among drawn robots, and among those of ranges."""
    from geomid_ros.exports.torque_spread import RANGE

    table = plain_table(
        "Width of the 95 % band of efforts in fast motion (RMS)",
        ["joint"],
        ["sampled robots", f"ranges of ±{100 * RANGE:.0f} %", "ratio"],
    )
    spread = found.torques
    rows = zip(spread.joints, spread.units, spread.drawn, spread.ranges, strict=True)
    for name, unit, drawn, ranges in rows:
        table.add_row(name, f"{drawn:.3g} {unit}", f"{ranges:.3g} {unit}", f"{drawn / ranges:.2f}")
    table.add_row("mean", "", "", f"{spread.ratio:.2f}")
    results_console().print(table)
