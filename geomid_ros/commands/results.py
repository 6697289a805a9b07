"""``geomid compare``, ``verify``, ``sample``, ``export``, ``feedforward`` and ``report``: commands on results on disk;
and ``payload``, on a result and a recording."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

import geomid_ros
from geomid_ros.commands.options import OUT, PATH, Output, options_of
from geomid_ros.commands.terminal import plain_table, print_remarks, print_verdict, progress_bar, results_console, say
from geomid_ros.errors import InputError, one_line
from geomid_ros.exports.formats import CONTROLLERS, JSON
from geomid_ros.files.models.readers import DESCRIBED_FOR
from geomid_ros.session.options import (
    CompareOptions,
    ExportOptions,
    FeedforwardOptions,
    PayloadOptions,
    SampleOptions,
    VerifyOptions,
)


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
        comparison = geomid_ros.compare(progress=progress, **options)
    page = comparison.report(out / "compare.html")
    if as_json:
        click.echo(json.dumps(comparison.document, indent=2))
    else:
        _show_comparison(comparison)
        click.echo(f"\nWritten: {page}")
    sys.exit(comparison.status)


def _show_comparison(comparison: geomid_ros.Comparison) -> None:
    """Print the verdict, a table of the differences, and the errors of both results."""
    from geomid_ros.checks.verdict import DOUBTFUL
    from geomid_ros.report.result_pages import error, row, verdict

    console = results_console()
    print_remarks(console, {DOUBTFUL.upper(): comparison.doubts, "Note": comparison.notes})
    for number, path in enumerate((comparison.first, comparison.second), 1):
        say(console, f"{number}:", f" {path}")
    say(console, "", verdict(comparison.compared))
    table = plain_table("", ["where", "parameter"], ["1", "2", "difference"])
    for difference in comparison.differing:
        table.add_row(*row(difference))
    table.add_section()
    for channel in comparison.errors:
        unit = f" [{channel.unit}]" if channel.unit else ""
        table.add_row(channel.name, f"RMS error{unit}", error(channel.first), error(channel.second), "")
    console.print(table)
    say(console, "±:", " the 95 % interval of a value, the joint 95 % interval of a difference")
    if comparison.errors:
        say(console, "RMS errors:", f" on {comparison.judged_on}")
    for name in comparison.compared.not_compared:
        say(console, "Not compared:", f" {name}, identified together with other links in the second")


@click.command()
@click.argument("model", type=PATH)
@options_of(VerifyOptions)
@click.option("--validate", required=True, multiple=True, type=PATH, help="Bag to predict; may be repeated.")
def verify(**options: Any) -> None:
    """Check that a model predicts a recording.

    Reads MODEL (an estimate.json), predicts the bags of --validate, and checks the requirements. The exit status is 0
    if all hold, 1 if one fails or if the model or a recording is doubtful, and 2 if the input is refused. The floor of
    an rms is the noise that "geomid gap" found, or the residual RMS on the data that the model was identified from.
    """

    with progress_bar() as progress:
        verification = geomid_ros.verify(progress=progress, **options)
    _show_verification(verification)
    sys.exit(0 if verification.passed else 1)


def _show_verification(result: geomid_ros.Verification) -> None:
    """Print channels and requirements."""
    from geomid_ros.checks.verdict import DOUBTFUL

    console = results_console()
    said = {result.session.loaded.warning, *result.doubts}
    warnings = [sentence for sentence in result.session.review.warnings() if sentence not in said]
    print_remarks(console, {DOUBTFUL.upper(): result.doubts, "Warning": warnings, "Note": result.session.notes})
    given = Path(result.session.robot.source).name or "URDF"
    table = plain_table("RMS of the residual", ["channel"], ["unit", given, "model", "floor"])
    for channel in result.session.model.channels:
        numbers = result.rms[channel.name]
        table.add_row(channel.name, channel.unit, *(_number(numbers[key]) for key in ("urdf", "value", "floor")))
    console.print(table)
    table = plain_table("Requirements", ["requirement", "of"], ["value", "bound", "result"])
    for outcome in result.outcomes:
        table.add_row(outcome.requirement, outcome.what, _number(outcome.value), outcome.bound, outcome.result)
    if result.outcomes:
        console.print(table)
    checked = [outcome.passed for outcome in result.outcomes if outcome.passed is not None]
    skipped = len(result.outcomes) - len(checked)
    summary = [f"{sum(checked)} of {len(checked)} requirements hold"] if result.outcomes else [_NOT_REQUIRED]
    summary += [f"{skipped} not checked"] * bool(skipped) + ["doubtful"] * bool(result.doubts)
    heading = "FAILED" if not result.passed else "PASSED" if result.outcomes else "NOT CHECKED"
    say(console, f"{heading}:", f" {', '.join(summary)}")


_NOT_REQUIRED = "no requirement is given (--require)"


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "not measured"


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

    sampled = geomid_ros.sample(**options)
    for heading, sentence in (("Warning", sampled.drawn.model.warning), ("Note", sampled.drawn.not_drawn)):
        if sentence:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    with progress_bar() as progress:
        *robots, ranges, picture = sampled.save(out, progress=progress)
    _show_spread(sampled)
    files = f"{robots[0]} to {robots[-1].name}" if len(robots) > 1 else str(robots[0])
    click.echo(f"\nWritten: {files}, {ranges}, {picture}")


def _show_spread(sampled: geomid_ros.SampledRobots) -> None:
    """Print the spread of torques among sampled robots, and among robots from uniform ranges."""
    from geomid_ros.exports.posterior_samples import RANGE

    table = plain_table(
        "Width of the 95 % band of efforts in fast motion (RMS)",
        ["joint"],
        ["sampled robots", f"ranges of ±{100 * RANGE:.0f} %", "ratio"],
    )
    spread = sampled.torques
    rows = zip(spread.joints, spread.units, spread.drawn, spread.ranges, strict=True)
    for name, unit, drawn, ranges in rows:
        table.add_row(name, f"{drawn:.3g} {unit}", f"{ranges:.3g} {unit}", f"{drawn / ranges:.2f}")
    table.add_row("mean", "", "", f"{spread.ratio:.2f}")
    results_console().print(table)


@click.command()
@click.argument("model", metavar="FROM", type=PATH)
@click.option(
    "--for", "tool", required=True, type=click.Choice([*CONTROLLERS, *DESCRIBED_FOR]), help="Format, or controller."
)
@options_of(ExportOptions)
def export(**options: Any) -> None:
    """Print an estimate in the format of other software.

    FROM is an estimate.json with its identified.urdf in the same folder, or any URDF or xacro file. For ur (Universal
    Robots) and franka, prints the payload at the flange, as commands for the controller and its ROS driver. For urdf,
    moveit, isaac, gazebo and drake, prints a URDF of the robot; for mujoco, an MJCF. With --frame, prints the
    inertial of a payload instead. Each format gets its own fit, with only the parameters that it can hold; a note
    lists the others. Standard deviations are in comments. A payload that the data do not identify is refused, and so
    is a model whose verdict is not 'usable', without --force.

    Nothing is tested here: 'geomid identify --for' writes the same description and tests it on held-out data.
    """
    exported = geomid_ros.export(**options)
    for heading, sentences in (("Warning", exported.doubts), ("Note", exported.notes)):
        for sentence in sentences:
            click.echo(f"{heading}: {one_line(sentence)}", err=True)
    click.echo(exported.text, nl=False)


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


@click.command()
@click.argument("trajectory", type=PATH)
@click.option("--model", type=PATH, help="An estimate.json.  [default: the URDF alone]")
@options_of(FeedforwardOptions, without=("wrench",))
@click.option(
    "--out",
    type=Output(within=True),
    default=Path("trajectory_ff.yaml"),
    show_default=True,
    help="Where it goes: .yaml, .csv, or a folder for a rosbag.",
)
def feedforward(out: Path, **options: Any) -> None:
    """Fill the efforts of a trajectory.

    TRAJECTORY is a trajectory_msgs/JointTrajectory with velocities: YAML, as 'geomid excite' writes and 'ros2 topic
    echo' prints it (also of MoveIt's messages), or a rosbag. It comes back with the efforts of the identified model at
    every point, in the unit of the robot's messages, for a controller that adds them to its feedback, as the
    joint_trajectory_controller does. The motion stays what it is; points are added on it where the efforts need them.
    Refuses a trajectory that takes more effort than the URDF allows, and a model whose verdict is not 'usable'.
    """

    result = geomid_ros.feedforward(**options)
    result.save(out)
    _show_efforts(result)
    click.echo(f"\nWritten: {out}")


def _show_efforts(result: geomid_ros.Feedforward) -> None:
    """Print notes, and the efforts of each joint of a trajectory."""
    console, trajectory = results_console(), result.trajectory
    print_remarks(console, {"Note": result.notes})
    console.print(result.summary)
    headings = ["RMS", "largest", "limit", "interpolation error"]
    table = plain_table("Efforts of the motors [N m, N]", ["joint"], headings)
    rms = np.sqrt(np.mean(trajectory.efforts**2, axis=0))
    for joint, *numbers in zip(trajectory.joints, rms, result.largest, result.limits, result.errors, strict=True):
        table.add_row(joint, *(f"{number:.4g}" if np.isfinite(number) else "-" for number in numbers))
    console.print(table)


@click.command()
@click.argument("empty", type=PATH)
@click.argument("loaded", type=PATH)
@options_of(PayloadOptions)
@click.option("--for", "controller", type=click.Choice([*CONTROLLERS]), help="Print the commands that set the payload.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
def payload(empty: Path, loaded: Path, controller: str | None, as_json: bool, **options: Any) -> None:
    """Identify a payload.

    EMPTY and LOADED are recordings (folders, or .mcap and .db3 files) without and with the payload; all joints must
    move. Instead of a recording, EMPTY may be the estimate.json of an earlier 'geomid identify' without the payload.
    Prints mass, centre of mass and inertia in the axes of the flange, with the 95 % interval of the mass.
    """

    if as_json and controller:
        raise InputError("--json and --for exclude each other: the commands are no JSON; leave one out")
    with progress_bar() as progress:
        result = geomid_ros.weigh_payload(empty, loaded, progress=progress, **options)
    if as_json:
        click.echo(json.dumps(result.document, indent=2))
    else:
        _show_payload(result, controller)
    sys.exit(result.weighed.verdict.status)


def _show_payload(result: geomid_ros.Payload, controller: str | None) -> None:
    """Print reasons against using the payload, the payload, its numbers if any is identified, and the commands that
    set it."""
    from geomid_ros.estimation.estimate import QUANTITIES, UNITS

    console, weighed = results_console(), result.weighed
    print_verdict(console, weighed.verdict, ())
    say(console, "", result.sentence)
    print_remarks(console, {"Warning": weighed.warnings, "Note": weighed.notes})
    title, remarks = f"Payload in the axes of '{result.frame}'", ["unit", "identified"]
    table = plain_table(title, ["quantity"], ["value", "std"], remarks)
    rows = zip(QUANTITIES, result.inertial.quantities, result.inertial.std, UNITS, strict=True)
    for name, value, std, unit in rows:
        identified = "no" if name in weighed.cannot_tell else "yes"
        table.add_row(name, f"{value:.4g}", f"{std:.2g}", unit, identified)
    if not weighed.nothing_identified:
        console.print(table)
    if controller:
        click.echo(result.commands(controller), nl=False)
