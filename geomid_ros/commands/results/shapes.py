"""The links of a prior that was made from shapes, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from geomid_ros.commands.tables import number_columns, plain_table, results_console
from geomid_ros.model import shapes
from geomid_ros.model.shape_prior import LinkPrior, ShapePrior


def show(prior: ShapePrior, kept: Sequence[str]) -> None:
    """Print the links of a prior that was made from shapes, before and after."""
    table = plain_table(f"Links filled with {prior.density:.4g} kg/m³")
    for heading in ("\nlink", "\nshape"):
        table.add_column(heading, overflow="fold")
    number_columns(table, ["volume\n[litre]", "mass [kg]\nURDF", "\nprior"])
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
