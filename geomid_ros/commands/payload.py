"""``geomid payload``: what a robot carries, from a recording with it, and a recording or an estimate without it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.api.options import PayloadOptions
from geomid_ros.commands.options import PATH, options_of
from geomid_ros.commands.terminal import plain_table, print_verdict, progress_bar, results_console
from geomid_ros.exports.formats import CONTROLLERS


@click.command()
@click.argument("empty", type=PATH)
@click.argument("loaded", type=PATH)
@options_of(PayloadOptions)
@click.option("--for", "controller", type=click.Choice([*CONTROLLERS]), help="Print the commands that set the payload.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
def payload(empty: Path, loaded: Path, controller: str | None, as_json: bool, **options: Any) -> None:
    """Identify a payload.

    EMPTY and LOADED are recordings (folders, or .mcap and .db3 files) without and with the payload; all joints must
    move. Instead of a recording, EMPTY may be the estimate.json of an earlier 'geomid identify' without the payload.
    Prints mass, centre of mass and inertia in the axes of the flange, with the 95 % interval of the mass.
    """

    with progress_bar() as progress:
        found = geomid_ros.weigh_payload(empty, loaded, progress=progress, **options)
    if as_json:
        click.echo(json.dumps(found.document, indent=2))
    else:
        _show(found, controller)
    sys.exit(found.weighed.verdict.status)


def _show(found: geomid_ros.Payload, controller: str | None) -> None:
    """Print the payload, first why it should not be used, and the commands that set it."""
    from geomid_ros.estimation.uncertain_inertia import QUANTITIES, UNITS

    console = results_console()
    print_verdict(console, found.weighed.verdict, found.weighed.warnings, found.weighed.notes)
    console.print(found.sentence)
    table = plain_table(f"Payload in the axes of '{found.frame}'", ["quantity"], ["value", "std"])
    table.add_column("unit")
    table.add_column("identified")
    rows = zip(QUANTITIES, found.inertial.quantities, found.inertial.std, UNITS, strict=True)
    for name, value, std, unit in rows:
        known = "no" if name in found.weighed.cannot_tell else "yes"
        table.add_row(name, f"{value:.4g}", f"{std:.2g}", unit, known)
    console.print(table)
    if controller:
        click.echo(found.commands(controller), nl=False)
