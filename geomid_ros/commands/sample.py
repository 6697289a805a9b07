"""``geomid sample``: robots drawn from what an identification knows."""

from __future__ import annotations

from pathlib import Path

import click

from geomid_ros.commands.options import OUT, package_option
from geomid_ros.errors import one_line
from geomid_ros.exports.formats import DESCRIBED_FOR, JSON

_MOST = 100_000
_WIDEST = 3.0


@click.command()
@click.argument("model", metavar="ESTIMATE", type=click.Path(path_type=Path))
@click.option("-n", "count", type=click.IntRange(1, _MOST), default=100, show_default=True, help="Number of robots.")
@click.option(
    "--for", "tool", required=True, type=click.Choice([*DESCRIBED_FOR, JSON]), help="Software that will read them."
)
@click.option(
    "--into",
    metavar="MJCF",
    type=click.Path(path_type=Path),
    help="For mujoco: write this file with each robot's numbers for the bodies and joints of the same names; the rest "
    "is "
    "unchanged.",
)
@click.option(
    "--spread",
    type=click.FloatRange(0.0, _WIDEST, min_open=True),
    default=1.0,
    show_default=True,
    help="Factor on all standard deviations.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Random seed; the same seed gives the same robots.",
)
@package_option
@click.option("--out", default=Path("geomid_samples"), **OUT)
def sample(
    model: Path,
    count: int,
    tool: str,
    into: Path | None,
    spread: float,
    seed: int,
    package_path: dict[str, Path],
    out: Path,
) -> None:
    """Sample robots from the posterior.

    ESTIMATE is an estimate.json with the identified.urdf and the posterior.npz of the same run beside it. Links and
    effects are sampled jointly, and every robot is physically consistent. Writes a description of each robot as 'geomid
    export' does (json: one robots.json). Also writes ranges.yaml with the 95 % range of each number (for isaac with the
    event terms of Isaac Lab), and torques.png, which compares the spread of joint torques with that of ranges of 20 %.
    """
    if into and tool != "mujoco":
        raise click.UsageError("--into takes an MJCF and needs --for mujoco.")
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.commands.results import torques
    from geomid_ros.exports.drawn_robots import described, draw_robots
    from geomid_ros.exports.ranges import ranges_text
    from geomid_ros.exports.torque_spread import torque_spread
    from geomid_ros.files.disk import write_text
    from geomid_ros.report.torque_picture import torque_picture

    drawn = draw_robots(model, count, seed, spread)
    for heading, sentence in (("Warning", drawn.model.doubt), ("Note", drawn.not_drawn)):
        if sentence:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    ranges, picture, robots = out / "ranges.yaml", out / "torques.png", []
    with progress_bar() as progress:
        for name, text in described(drawn, tool, into, package_path):
            robots.append(out / name)
            progress("writing robots", len(robots) / count)
            write_text(robots[-1], text)
        progress("comparing torques", 0.0)
        write_text(ranges, ranges_text(drawn, isaac=tool == "isaac"))
        spread_of = torque_spread(drawn)
        names = [f"{name} [{unit}]" for name, unit in zip(spread_of.joints, spread_of.units, strict=True)]
        torque_picture(picture, f"{count} robots of {model}", names, spread_of.drawn, spread_of.ranges)
    torques.show(spread_of)
    files = f"{robots[0]} to {robots[-1].name}" if len(robots) > 1 else str(robots[0])
    click.echo(f"\nWritten: {files}, {ranges}, {picture}")
