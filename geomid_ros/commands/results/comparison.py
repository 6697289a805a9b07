"""Two results side by side, as a table."""

from __future__ import annotations

from geomid_ros.api.compare import Comparison
from geomid_ros.commands.tables import number_columns, plain_table, results_console, say
from geomid_ros.report.comparison_page import error, row, verdict


def show(found: Comparison) -> None:
    """Print whether the results differ, and a table of what differs and of the errors of both."""
    console = results_console()
    for heading, sentences in (("DOUBTFUL", found.doubts), ("Note", found.notes)):
        for sentence in sentences:
            say(console, f"{heading}:", f" {sentence}")
    for number, path in enumerate((found.first, found.second), 1):
        say(console, f"{number}:", f" {path}")
    say(console, "", verdict(found.compared))
    table = plain_table("")
    for heading in ("where", "parameter"):
        table.add_column(heading, overflow="fold")
    number_columns(table, ["1", "2", "difference"])
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
