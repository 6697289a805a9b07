"""A payload that was weighed, as a table."""

from __future__ import annotations

import click

from geomid_ros.commands.tables import number_columns, plain_table, print_remarks, results_console
from geomid_ros.estimation.estimate import QUANTITIES, UNITS
from geomid_ros.exports.weighed_payload import Payload


def show(found: Payload, controller: str | None) -> None:
    """Print the payload, first why it should not be used, and the commands that set it."""
    console = results_console()
    print_remarks(console, found.weighed.verdict, found.weighed.warnings, found.weighed.notes)
    console.print(found.sentence)
    table = plain_table(f"Payload in the axes of '{found.frame}'")
    table.add_column("quantity")
    number_columns(table, ["value", "std"])
    table.add_column("unit")
    table.add_column("identified")
    rows = zip(QUANTITIES, found.inertial.quantities, found.inertial.std, UNITS, strict=True)
    for name, value, std, unit in rows:
        known = "no" if name in found.weighed.cannot_tell else "yes"
        table.add_row(name, f"{value:.4g}", f"{std:.2g}", unit, known)
    console.print(table)
    if controller:
        click.echo(found.commands(controller), nl=False)
