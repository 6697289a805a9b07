"""``geomid verify``: whether a model still predicts, for continuous integration."""

from __future__ import annotations

import math
import sys
from typing import Any

import click
from rich.table import Table

import geomid_ros
from geomid_ros.api.options import VerifyOptions
from geomid_ros.commands.options import PATH, options_of
from geomid_ros.commands.terminal import plain_table, print_remarks, progress_bar, results_console, say


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
        found = geomid_ros.verify(progress=progress, **options)
    _show(found)
    sys.exit(0 if found.passed else 1)


def _show(found: geomid_ros.Verification) -> None:
    """Print channels and requirements."""
    console = results_console()
    warnings = [sentence for sentence in found.session.review.warnings() if sentence not in found.doubts]
    print_remarks(console, {"DOUBTFUL": found.doubts, "Warning": warnings, "Note": found.session.notes})
    console.print(_channels(found))
    if found.outcomes:
        console.print(_requirements(found))
    judged = [outcome.passed for outcome in found.outcomes if outcome.passed is not None]
    others = len(found.outcomes) - len(judged)
    kept = f"{sum(judged)} of {len(judged)} requirements hold" + (f", {others} not judged" if others else "")
    say(console, "PASSED:" if found.passed else "FAILED:", f" {kept}" + ("; doubtful" if found.doubts else ""))


def _channels(found: geomid_ros.Verification) -> Table:
    table = plain_table("RMS of the residual", ["channel"], ["unit", "URDF", "model", "floor"])
    for channel in found.session.model.channels:
        numbers = found.rms[channel.name]
        table.add_row(channel.name, channel.unit, *(_written(numbers[key]) for key in ("urdf", "value", "floor")))
    return table


def _requirements(found: geomid_ros.Verification) -> Table:
    table = plain_table("Requirements", ["requirement", "of"], ["value", "bound", "result"])
    for outcome in found.outcomes:
        result = {True: "passed", False: "FAILED", None: "not judged"}[outcome.passed]
        table.add_row(outcome.requirement, outcome.what, _written(outcome.value), outcome.bound, result)
    return table


def _written(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "not measured"
