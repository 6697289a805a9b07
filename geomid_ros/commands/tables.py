"""Estimates as tables in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from geomid_ros.estimation.estimate import QUANTITIES, Estimate, LinkEstimate
from geomid_ros.model import shapes
from geomid_ros.model.shape_prior import LinkPrior, ShapePrior
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_WIDTH_OF_FILES = 110


def print_estimate(session: Session, estimate: Estimate, nominal: FloatArray, held_out: FloatArray | None) -> None:
    """Print links, effects and how well each channel is predicted, on data held out where there are any."""
    console = results_console()
    state = "converged" if estimate.converged else f"NOT converged ({estimate.reason})"
    console.print(
        f"{estimate.rows_accepted} rows, {state} in {estimate.seconds:.1f} s, prior's weight {estimate.gamma:.1e}",
        highlight=False,
    )
    console.print(links_table(session, estimate.links))
    if estimate.known:
        console.print(_known_table(estimate))
    if estimate.effects:
        console.print(_effects_table(estimate))
    console.print(_channels_table(session, estimate, nominal, held_out))


def results_console() -> Console:
    """Standard output; in a file or a pipe, lines may be wider than the 80 columns that rich assumes there."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH_OF_FILES)


def plain_table(title: str) -> Table:
    """A table without lines between rows."""
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def number_columns(table: Table, headings: Sequence[str]) -> None:
    """Add columns of numbers."""
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)


def links_table(session: Session, links: Sequence[LinkEstimate]) -> Table:
    """Mass, centre of mass, their standard deviations and where they came from."""
    nominal = dict(zip(session.model.body_names, session.model.nominal_inertias.reshape(-1, 10)[:, 0], strict=True))
    table = plain_table("Links")
    table.add_column("\nlink", overflow="fold", min_width=14)
    headings = ("mass [kg]\nURDF", "\nidentified", "centre of\nmass [m]", "from\ndata", "dist. to\nprior")
    number_columns(table, headings)
    table.add_column("cannot be\ntold alone", min_width=10)
    for link in links:
        com = "\n".join(f"{c:+.3f} ± {s:.3f}" for c, s in zip(link.com, link.std_com, strict=True))
        table.add_row(
            "\n".join([link.name, *(f"+ {name}" for name in link.merged)]),
            f"{nominal[link.name]:.3f}",
            f"{link.mass:.3f} ± {link.std_mass:.3f}",
            com,
            f"{100 * link.from_data:.0f} %",
            f"{link.distance_from_prior:.2f}",
            _cannot_tell(link),
        )
    return table


def _cannot_tell(link: LinkEstimate) -> str:
    if len(link.cannot_tell) == len(QUANTITIES):
        return "anything"
    parts = ["mass"] if "mass" in link.cannot_tell else []
    for letter, name in (("c", "centre of mass"), ("I", "inertia")):
        group = [quantity for quantity in QUANTITIES if quantity.startswith(letter)]
        untold = [quantity for quantity in group if quantity in link.cannot_tell]
        parts += [name] if len(untold) == len(group) else untold
    return ", ".join(parts)


def _known_table(estimate: Estimate) -> Table:
    table = plain_table("Weighed masses")
    table.add_column("what", overflow="fold")
    number_columns(table, ["weighed [kg]", "identified [kg]", "difference [std weighed]"])
    for known in estimate.known:
        table.add_row(
            known.name,
            f"{known.given:.3f} ± {known.given_std:.3f}",
            f"{known.mass:.3f} ± {known.std:.3f}",
            f"{(known.mass - known.given) / known.given_std:+.1f}",
        )
    return table


def _effects_table(estimate: Estimate) -> Table:
    names = list(dict.fromkeys(effect.name for effect in estimate.effects))
    joints = list(dict.fromkeys(effect.joint for effect in estimate.effects))
    values = {(effect.name, effect.joint): effect for effect in estimate.effects}
    table = plain_table("Joint effects")
    table.add_column("joint", overflow="fold")
    for name in names:
        units = {effect.unit for effect in estimate.effects if effect.name == name}
        first, _, second = name.partition("_")
        number_columns(table, [f"{first}\n{second}\n[{', '.join(sorted(units))}]"])
    for joint in joints:
        effects = [values[name, joint] for name in names]
        table.add_row(joint, *(f"{effect.value:.3g} ± {effect.std:.1g}" for effect in effects))
    return table


def _channels_table(session: Session, estimate: Estimate, nominal: FloatArray, held_out: FloatArray | None) -> Table:
    table = plain_table("RMS of what remains, on " + ("held-out data" if held_out is not None else "the same data"))
    after = held_out if held_out is not None else estimate.rms
    table.add_column("channel", overflow="fold")
    number_columns(table, ["unit", "URDF", "identified", "explained"])
    for channel, before, now in zip(session.model.channels, nominal, after, strict=True):
        if np.isfinite(now):
            share = f"{100.0 * (1.0 - now / before):.0f} %" if before > 0 else ""
            table.add_row(channel.name, channel.unit, f"{before:.3g}", f"{now:.3g}", share)
    return table


def print_prior(prior: ShapePrior, kept: Sequence[str]) -> None:
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
    table.add_row("together", "", "", f"{prior.mass_before:.3f}", f"{prior.mass:.3f}", "")
    results_console().print(table)


def _shape(link: LinkPrior, kept: Sequence[str]) -> str:
    if link.name in kept:
        return "kept as it is"
    return link.solid.shape if link.solid else "none, stays as it is"
