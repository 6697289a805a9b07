"""``geomid payload``: what a robot carries, from a recording without it and one with it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import URDF
from geomid_ros.commands.progress import progress_bar
from geomid_ros.commands.tables import number_columns, plain_table, print_remarks, results_console
from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.plausibility.verdict import recording_status
from geomid_ros.session.payload import GAIN

_UNITS = ("kg", *("m",) * 3, *("kg m^2",) * 6)


@click.command()
@click.argument("empty", type=click.Path(path_type=Path))
@click.argument("loaded", type=click.Path(path_type=Path))
@click.option("--urdf", required=True, **URDF)
@click.option("--frame", metavar="LINK", help="The flange.  [default: the last link that moves]")
@click.option("--for", "controller", type=click.Choice([*CONTROLLERS]), help="Print the commands that set the payload.")
@click.option(
    "--gain",
    type=click.FloatRange(0.0, 1.0, max_open=True),
    default=GAIN,
    show_default=True,
    help="Standard deviation of the efforts' common gain; 0 for calibrated torque sensors.",
)
@click.option("--joint-topic", default="joint_states", show_default=True, help="Topic of the joint states.")
@click.option("--wrench", multiple=True, metavar="TOPIC:FRAME:ROLE[:AXES]", help="A wrench topic, as in identify.")
@click.option("--config", type=click.Path(path_type=Path), help="The node's parameter file (YAML).")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
def payload(empty: Path, loaded: Path, urdf: Path, controller: str | None, as_json: bool, **options: Any) -> None:
    """Weigh what a robot carries.

    Compares two recordings (folders, or .mcap and .db3 files) in which all joints move: EMPTY without the payload and
    LOADED with it. Prints mass, centre of mass and inertia in the axes of the flange, with the interval of the mass.
    """
    with progress_bar() as progress:
        found = geomid_ros.weigh_payload(empty, loaded, urdf, progress=progress, **options)
    if as_json:
        click.echo(json.dumps(found.document, indent=2))
    else:
        _print(found, controller)
    sys.exit(recording_status(found.weighed.findings))


def _print(found: geomid_ros.Payload, controller: str | None) -> None:
    """Print the payload, what makes it doubtful first, and the commands that set it."""
    console = results_console()
    print_remarks(console, [finding.sentence for finding in found.weighed.findings], found.weighed.warnings)
    console.print(found.sentence)
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
