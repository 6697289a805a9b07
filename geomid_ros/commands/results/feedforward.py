"""A trajectory with efforts, as a table."""

from __future__ import annotations

import numpy as np

from geomid_ros.api.feedforward import Feedforward
from geomid_ros.commands.tables import number_columns, plain_table, results_console, say


def show(found: Feedforward) -> None:
    """Print notes, and the efforts of each joint."""
    console = results_console()
    for note in found.notes:
        say(console, "Note:", f" {note}")
    trajectory = found.trajectory
    console.print(f"{trajectory.duration:g} s, {len(trajectory.times)} points ({found.given} were given)")
    table = plain_table("Efforts of the motors [N m, N]")
    table.add_column("joint", overflow="fold")
    number_columns(table, ["RMS", "largest", "limit", "interpolation error"])
    rms = np.sqrt(np.mean(trajectory.efforts**2, axis=0))
    for joint, *numbers in zip(trajectory.joints, rms, found.largest, found.limits, found.errors, strict=True):
        table.add_row(joint, *(f"{number:.4g}" if np.isfinite(number) else "-" for number in numbers))
    console.print(table)
