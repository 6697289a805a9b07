"""Estimates as tables in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from geomid_ros.estimation.estimate import Estimate, LinkEstimate
from geomid_ros.estimation.estimator import QUANTITIES
from geomid_ros.session import Session
from geomid_ros.types import FloatArray

_WIDTH_OF_FILES = 110


def print_estimate(session: Session, estimate: Estimate, nominal: FloatArray, held_out: FloatArray | None) -> None:
    """Print links, effects and how well each channel is predicted, on data held out where there are any."""
    console = _console()
    state = "converged" if estimate.converged else f"NOT converged ({estimate.reason})"
    console.print(
        f"{estimate.rows_accepted} rows, {state} in {estimate.seconds:.1f} s, prior's weight {estimate.gamma:.1e}",
        highlight=False,
    )
    console.print(links_table(session, estimate.links))
    if estimate.effects:
        console.print(_effects_table(estimate))
    console.print(_channels_table(session, estimate, nominal, held_out))


def _console() -> Console:
    """Standard output; in a file or a pipe, lines may be wider than the 80 columns that rich assumes there."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH_OF_FILES)


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def _number_columns(table: Table, headings: Sequence[str]) -> None:
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)


def links_table(session: Session, links: Sequence[LinkEstimate]) -> Table:
    """Mass, centre of mass, their standard deviations and where they came from."""
    nominal = dict(zip(session.model.body_names, session.model.nominal_inertias.reshape(-1, 10)[:, 0], strict=True))
    table = _table("Links")
    table.add_column("\nlink", overflow="fold", min_width=14)
    headings = ("mass [kg]\nURDF", "\nidentified", "centre of\nmass [m]", "from\ndata", "dist. to\nprior")
    _number_columns(table, headings)
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


def _effects_table(estimate: Estimate) -> Table:
    names = list(dict.fromkeys(effect.name for effect in estimate.effects))
    joints = list(dict.fromkeys(effect.joint for effect in estimate.effects))
    values = {(effect.name, effect.joint): effect for effect in estimate.effects}
    table = _table("Joint effects")
    table.add_column("joint", overflow="fold")
    for name in names:
        units = {effect.unit for effect in estimate.effects if effect.name == name}
        first, _, second = name.partition("_")
        _number_columns(table, [f"{first}\n{second}\n[{', '.join(sorted(units))}]"])
    for joint in joints:
        effects = [values[name, joint] for name in names]
        table.add_row(joint, *(f"{effect.value:.3g} ± {effect.std:.1g}" for effect in effects))
    return table


def _channels_table(session: Session, estimate: Estimate, nominal: FloatArray, held_out: FloatArray | None) -> Table:
    table = _table("RMS of what remains, on " + ("held-out data" if held_out is not None else "the same data"))
    after = held_out if held_out is not None else estimate.rms
    table.add_column("channel", overflow="fold")
    _number_columns(table, ["unit", "URDF", "identified", "explained"])
    for channel, before, now in zip(session.model.channels, nominal, after, strict=True):
        if np.isfinite(now):
            share = f"{100.0 * (1.0 - now / before):.0f} %" if before > 0 else ""
            table.add_row(channel.name, channel.unit, f"{before:.3g}", f"{now:.3g}", share)
    return table
