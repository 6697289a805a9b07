"""``geomid verify``: whether a model still predicts, for continuous integration."""

from __future__ import annotations

import sys
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import PATH, robot_options


@click.command()
@click.argument("model", type=PATH)
@robot_options
@click.option(
    "--validate",
    required=True,
    multiple=True,
    type=PATH,
    help="Bag to predict; may be repeated.",
)
@click.option(
    "--require",
    multiple=True,
    metavar="[PLACE.]QUANTITY<BOUND",
    help="Requirement, such as rms<2*floor, joint2.rms<1.5, rms<0.5*urdf, total.mass>20, link3.mass<1.1*urdf, "
    "from_data>=0.1; may be repeated.",
)
def verify(**options: Any) -> None:
    """Check that a model predicts a recording.

    Reads MODEL (an estimate.json), predicts the bags of --validate, and checks the requirements. The exit status is 0
    if all hold, 1 if one fails or if the model or a recording is doubtful, and 2 if the input is refused. The floor of
    an rms is the noise that "geomid gap" found, or the residual RMS on the data that the model was identified from.
    """
    from geomid_ros.commands.results.tables import show_verification
    from geomid_ros.commands.terminal import progress_bar

    with progress_bar() as progress:
        found = geomid_ros.verify(progress=progress, **options)
    show_verification(found)
    sys.exit(0 if found.passed else 1)
