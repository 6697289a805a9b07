"""``geomid verify``: whether a model still predicts, for continuous integration."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

import geomid_ros
from geomid_ros.commands.options import base_options, robot_options


@click.command()
@click.argument("model", type=click.Path(path_type=Path))
@robot_options
@base_options
@click.option(
    "--validate",
    required=True,
    multiple=True,
    type=click.Path(path_type=Path),
    help="A bag to predict; may be repeated.",
)
@click.option(
    "--require",
    multiple=True,
    metavar="[PLACE.]QUANTITY<BOUND",
    help="What must be so, as rms<2*floor, joint2.rms<1.5, rms<0.5*urdf, total.mass>20, link3.mass<1.1*urdf, "
    "from_data>=0.1; may be repeated.",
)
def verify(**options: Any) -> None:
    """Check that a model predicts a recording.

    Reads MODEL (an estimate.json), predicts the bags of --validate with it, and says what is as required. The exit
    status is 0 if all is, 1 if anything is not or the model or a recording is doubtful, and 2 for a refusal. The floor
    of an rms is the noise that "geomid gap" found, or what the model left of the data that it was identified from.
    """
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.commands.results import verification

    with progress_bar() as progress:
        found = geomid_ros.verify(progress=progress, **options)
    verification.show(found)
    sys.exit(0 if found.passed else 1)
