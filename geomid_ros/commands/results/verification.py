"""How well a model predicts a recording, and what was required of it, as tables."""

from __future__ import annotations

import math

from rich.table import Table

from geomid_ros.api.verify import Verification
from geomid_ros.commands.tables import number_columns, plain_table, results_console, say

_NONE = "not measured"


def show(found: Verification) -> None:
    """Print channels and requirements."""
    console = results_console()
    for heading, sentences in (
        ("DOUBTFUL", found.doubts),
        ("Warning", found.session.warnings()),
        ("Note", found.session.notes),
    ):
        for sentence in sentences:
            if heading != "Warning" or sentence not in found.doubts:
                say(console, f"{heading}:", f" {sentence}")
    console.print(_channels(found))
    if found.outcomes:
        console.print(_requirements(found))
    failed = sum(not outcome.passed for outcome in found.outcomes)
    kept = f"{len(found.outcomes) - failed} of {len(found.outcomes)} requirements hold"
    say(console, "PASSED:" if found.passed else "FAILED:", f" {kept}" + ("; doubtful" if found.doubts else ""))


def _channels(found: Verification) -> Table:
    table = plain_table("RMS of the residual")
    table.add_column("channel", overflow="fold")
    number_columns(table, ["unit", "URDF", "model", "floor"])
    for channel in found.session.model.channels:
        numbers = found.rms[channel.name]
        table.add_row(channel.name, channel.unit, *(_written(numbers[key]) for key in ("urdf", "value", "floor")))
    return table


def _requirements(found: Verification) -> Table:
    table = plain_table("Requirements")
    for heading in ("requirement", "of"):
        table.add_column(heading, overflow="fold")
    number_columns(table, ["value", "bound", "result"])
    for outcome in found.outcomes:
        result = "passed" if outcome.passed else "FAILED"
        table.add_row(outcome.requirement, outcome.what, _written(outcome.value), outcome.bound, result)
    return table


def _written(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else _NONE
