"""What ``geomid sample`` prints."""

from __future__ import annotations

from rich import box
from rich.table import Table

from geomid_ros.commands.tables import results_console
from geomid_ros.exports.torque_spread import RANGE, TorqueSpread


def show(spread: TorqueSpread) -> None:
    """Print how much torques differ among drawn robots, and among those of ranges."""
    table = Table(
        box=box.SIMPLE_HEAD, title="Width of the 95 % band of efforts in fast motion (RMS)", title_justify="left"
    )
    for heading in ("joint", "sampled robots", f"ranges of ±{100 * RANGE:.0f} %", "ratio"):
        table.add_column(heading, justify="left" if heading == "joint" else "right")
    rows = zip(spread.joints, spread.units, spread.drawn, spread.ranges, strict=True)
    for name, unit, drawn, ranges in rows:
        table.add_row(name, f"{drawn:.3g} {unit}", f"{ranges:.3g} {unit}", f"{drawn / ranges:.2f}")
    table.add_row("mean", "", "", f"{spread.ratio:.2f}")
    results_console().print(table)
