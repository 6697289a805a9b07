"""What ``geomid fleet`` prints."""

from __future__ import annotations

from geomid_ros.api.fleet import FleetIdentification
from geomid_ros.commands.tables import lines, number_columns, plain_table, results_console, say


def show(found: FleetIdentification) -> None:
    """Print a table of the robots, and the bags that were bad."""
    console = results_console()
    table = plain_table(f"{len(found.lines)} robots")
    table.add_column("robot")
    number_columns(table, ("bags", "mass [kg]", "distance"))
    table.add_column("verdict")
    table.add_column("differs from the others")
    table.add_column("changed")
    for line in found.lines:
        numbers = ("" if number is None else f"{number:.2f}" for number in (line.mass, line.distance))
        remarks = (line.verdict, lines(line.unlike), lines(line.changed))
        table.add_row(line.name, f"{line.used} of {line.bags}", *numbers, *remarks)
    console.print(table)
    for line in found.lines:
        for reason in line.reasons:
            say(console, f"{line.name}:", f" {reason}")
    for bag, why in found.bad:
        say(console, "Bad bag:", f" {why if bag in why else f'{bag}: {why}'}")
    for bag, what in found.doubtful:
        say(console, "Doubtful bag:", f" {bag}: {what}")
    console.print(f"\nWritten: {', '.join(map(str, found.files))}")
