"""Results that are one or two tables each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.table import Table

from geomid_ros.commands.terminal import (
    lines,
    plain_table,
    print_remarks,
    print_verdict,
    results_console,
    say,
)
from geomid_ros.estimation.estimate import QUANTITIES, UNITS
from geomid_ros.model import shapes

if TYPE_CHECKING:
    from geomid_ros.api.compare import Comparison
    from geomid_ros.api.feedforward import Feedforward
    from geomid_ros.api.fleet import FleetIdentification
    from geomid_ros.api.verify import Verification
    from geomid_ros.exports.torque_spread import TorqueSpread
    from geomid_ros.exports.weighed_payload import Payload
    from geomid_ros.model.shape_prior import LinkPrior, ShapePrior


def show_comparison(found: Comparison) -> None:
    """Print whether the results differ, and a table of what differs and of the errors of both."""
    from geomid_ros.report.plain_pages import error, row, verdict

    console = results_console()
    print_remarks(console, {"DOUBTFUL": found.doubts, "Note": found.notes})
    for number, path in enumerate((found.first, found.second), 1):
        say(console, f"{number}:", f" {path}")
    say(console, "", verdict(found.compared))
    table = plain_table("", ["where", "parameter"], ["1", "2", "difference"])
    for difference in found.differing:
        table.add_row(*row(difference))
    table.add_section()
    for channel in found.errors:
        unit = f" [{channel.unit}]" if channel.unit else ""
        table.add_row(channel.name, f"RMS error{unit}", error(channel.first), error(channel.second), "")
    console.print(table)
    say(console, "±:", " the 95 % interval of a value, the joint 95 % interval of a difference")
    if found.errors:
        say(console, "RMS errors:", f" on {found.judged_on}")
    for name in found.compared.not_compared:
        say(console, "Not compared:", f" {name}, identified together with other links in the second")


def show_feedforward(found: Feedforward) -> None:
    """Print notes, and the efforts of each joint of a trajectory."""
    console, trajectory = results_console(), found.trajectory
    print_remarks(console, {"Note": found.notes})
    console.print(f"{trajectory.duration:g} s, {len(trajectory.times)} points ({found.given} were given)")
    headings = ["RMS", "largest", "limit", "interpolation error"]
    table = plain_table("Efforts of the motors [N m, N]", ["joint"], headings)
    rms = np.sqrt(np.mean(trajectory.efforts**2, axis=0))
    for joint, *numbers in zip(trajectory.joints, rms, found.largest, found.limits, found.errors, strict=True):
        table.add_row(joint, *(f"{number:.4g}" if np.isfinite(number) else "-" for number in numbers))
    console.print(table)


def show_fleet(found: FleetIdentification) -> None:
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


def show_payload(found: Payload, controller: str | None) -> None:
    """Print the payload, first why it should not be used, and the commands that set it."""
    console = results_console()
    print_verdict(console, found.weighed.verdict, found.weighed.warnings, found.weighed.notes)
    console.print(found.sentence)
    table = plain_table(f"Payload in the axes of '{found.frame}'", ["quantity"], ["value", "std"])
    table.add_column("unit")
    table.add_column("identified")
    rows = zip(QUANTITIES, found.inertial.quantities, found.inertial.std, UNITS, strict=True)
    for name, value, std, unit in rows:
        known = "no" if name in found.weighed.cannot_tell else "yes"
        table.add_row(name, f"{value:.4g}", f"{std:.2g}", unit, known)
    console.print(table)
    if controller:
        click.echo(found.commands(controller), nl=False)


def show_shapes(prior: ShapePrior, kept: Sequence[str]) -> None:
    """Print the links of a prior that was made from shapes, before and after."""
    table = plain_table(
        f"Links filled with {prior.density:.4g} kg/m³",
        ["\nlink", "\nshape"],
        ["volume\n[litre]", "mass [kg]\nURDF", "\nprior"],
    )
    table.add_column("the URDF's\ninertial")
    for link in prior.links:
        before = "" if link.before.parameters is None else f"{link.before.mass:.3f}"
        after = f"{link.mass:.3f}" if link.mass else ""
        volume = f"{1000.0 * shapes.volume(link.solid.moments):.3f}" if link.solid else ""
        table.add_row(link.name, _shape(link, kept), volume, before, after, link.verdict or "plausible")
    table.add_section()
    table.add_row("total", "", "", f"{prior.mass_before:.3f}", f"{prior.mass:.3f}", "")
    results_console().print(table)


def _shape(link: LinkPrior, kept: Sequence[str]) -> str:
    if link.name in kept:
        return "kept"
    return link.solid.shape if link.solid else "none, unchanged"


def show_torques(spread: TorqueSpread) -> None:
    """Print how much torques differ among drawn robots, and among those of ranges."""
    from geomid_ros.exports.torque_spread import RANGE

    table = plain_table(
        "Width of the 95 % band of efforts in fast motion (RMS)",
        ["joint"],
        ["sampled robots", f"ranges of ±{100 * RANGE:.0f} %", "ratio"],
    )
    rows = zip(spread.joints, spread.units, spread.drawn, spread.ranges, strict=True)
    for name, unit, drawn, ranges in rows:
        table.add_row(name, f"{drawn:.3g} {unit}", f"{ranges:.3g} {unit}", f"{drawn / ranges:.2f}")
    table.add_row("mean", "", "", f"{spread.ratio:.2f}")
    results_console().print(table)


def show_verification(found: Verification) -> None:
    """Print channels and requirements."""
    console = results_console()
    warnings = [sentence for sentence in found.session.warnings() if sentence not in found.doubts]
    print_remarks(console, {"DOUBTFUL": found.doubts, "Warning": warnings, "Note": found.session.notes})
    console.print(_channels(found))
    if found.outcomes:
        console.print(_requirements(found))
    failed = sum(not outcome.passed for outcome in found.outcomes)
    kept = f"{len(found.outcomes) - failed} of {len(found.outcomes)} requirements hold"
    say(console, "PASSED:" if found.passed else "FAILED:", f" {kept}" + ("; doubtful" if found.doubts else ""))


def _channels(found: Verification) -> Table:
    table = plain_table("RMS of the residual", ["channel"], ["unit", "URDF", "model", "floor"])
    for channel in found.session.model.channels:
        numbers = found.rms[channel.name]
        table.add_row(channel.name, channel.unit, *(_written(numbers[key]) for key in ("urdf", "value", "floor")))
    return table


def _requirements(found: Verification) -> Table:
    table = plain_table("Requirements", ["requirement", "of"], ["value", "bound", "result"])
    for outcome in found.outcomes:
        result = "passed" if outcome.passed else "FAILED"
        table.add_row(outcome.requirement, outcome.what, _written(outcome.value), outcome.bound, result)
    return table


def _written(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "not measured"
