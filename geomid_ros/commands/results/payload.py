"""A payload that was weighed, as a table and as JSON."""

from __future__ import annotations

from typing import Any

import click

from geomid_ros.api.payload import Payload
from geomid_ros.commands.tables import number_columns, plain_table, print_remarks, results_console
from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.files.models.judgements import causes_entry

_UNITS = ("kg", *("m",) * 3, *("kg m^2",) * 6)


def show(found: Payload, controller: str | None) -> None:
    """Print the payload, what makes it doubtful first, and the commands that set it."""
    console = results_console()
    low, high = found.interval
    print_remarks(console, [finding.sentence for finding in found.weighed.findings], found.weighed.warnings)
    gain = f", an uncertain gain of {100.0 * found.weighed.gain:.3g} % included" if found.weighed.gain else ""
    console.print(f"{found.mass:.3f} kg, from {low:.3f} to {high:.3f} kg (95 %{gain})")
    table = plain_table(f"Payload in the axes of '{found.frame}'")
    table.add_column("quantity")
    number_columns(table, ["value", "std"])
    table.add_column("unit")
    table.add_column("told by the motions")
    rows = zip(QUANTITIES, found.inertial.quantities, found.inertial.std, _UNITS, strict=True)
    for name, value, std, unit in rows:
        told = "no" if name in found.weighed.cannot_tell else "yes"
        table.add_row(name, f"{value:.4g}", f"{std:.2g}", unit, told)
    console.print(table)
    if controller:
        click.echo(found.commands(controller), nl=False)


def document(found: Payload) -> dict[str, Any]:
    """All numbers."""
    quantities, std = found.inertial.quantities.tolist(), found.inertial.std.tolist()
    return {
        "frame": found.frame,
        "interval": list(found.interval),
        "gain": found.weighed.gain,
        "quantities": dict(zip(QUANTITIES, quantities, strict=True)),
        "std": dict(zip(QUANTITIES, std, strict=True)),
        "cannot_tell": list(found.weighed.cannot_tell),
        "rms": found.weighed.rms,
        "warnings": list(found.weighed.warnings),
        "causes": causes_entry(found.weighed.findings),
    }
