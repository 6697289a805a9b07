"""``geomid identify``: link inertias from rosbags."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from geomid_ros.commands.options import URDF, configured, held_out_share, recording_options
from geomid_ros.commands.progress import tracked, working
from geomid_ros.commands.tables import print_estimate
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.report.picture import draw_identification
from geomid_ros.session.recordings import Topics, check_efforts, read_samples
from geomid_ros.session.session import Session


@click.command()
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--urdf", required=True, **URDF)
@recording_options
@click.option("--effects", help="Identify these effects, separated by commas; 'none' for none.")
@click.option("--links", help="Identify only these links, separated by commas.")
@click.option(
    "--known",
    multiple=True,
    metavar="LINK=MASS:STD",
    help="A mass that was weighed, of a link, of LINK+LINK together, or total; may be repeated.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("geomid_out"),
    show_default=True,
    help="Folder for results.",
)
@click.option("--json", "as_json", is_flag=True, help="Print estimate.json instead of tables.")
def identify(
    bags: tuple[Path, ...],
    urdf: Path,
    config: Path | None,
    model: Path | None,
    effects: str | None,
    links: str | None,
    floating_base: bool,
    wrench: tuple[str, ...],
    known: tuple[str, ...],
    joint_topic: str,
    odom_topic: str,
    hold_out: float | None,
    validate: tuple[Path, ...],
    out: Path,
    as_json: bool,
) -> None:
    """Identify link inertias from rosbags.

    Reads BAGS (folders, or .mcap and .db3 files) and writes estimate.json, identified.urdf and identification.png. How
    well the result predicts is judged on data that were held out: the end of each bag, or the bags of --validate.
    """
    chosen = _chosen(effects, links, known)
    configuration = configured(config, model, floating_base, wrench, **chosen)
    session = Session(read_urdf(urdf), configuration, str(urdf))
    topics = Topics(joint_topic, odom_topic)
    share = held_out_share(hold_out, validate)
    held_out: list[Samples] = []
    train: list[Samples] = []
    for path in bags:
        _read_bag(path, session, topics, share, train, held_out)
    for path in validate:
        _read_bag(path, session, topics, 1.0, train, held_out)
    if not train:
        raise InputError(f"{', '.join(map(str, bags))}: too short, nothing is left to identify from")
    check_efforts(session, train, bags)
    for samples in train:
        session.identifier.add(samples)
    with working("solving"):
        estimate = session.identifier.solve()
    held_out_rms = session.rms(held_out, estimate.parameters) if held_out else None
    document = session.save(out, estimate, held_out_rms)
    shown = Samples.concatenate(held_out or train)
    picture = out / "identification.png"
    with working("drawing"):
        draw_identification(picture, session, estimate, shown, "held-out data" if held_out else "training data")
    if as_json:
        click.echo(json.dumps(document, indent=2))
    else:
        nominal = session.rms(held_out, session.nominal_parameters) if held_out else estimate.rms_nominal
        print_estimate(session, estimate, nominal, held_out_rms)
        if session.loaded.not_predicted:
            click.echo(f"\n{session.loaded.not_predicted}")
        click.echo(f"\nWritten: {out / 'estimate.json'}, {out / 'identified.urdf'}, {picture}")


def _chosen(effects: str | None, links: str | None, known: tuple[str, ...]) -> dict[str, list[str]]:
    """Parameters that the options say what to identify with."""
    values = {}
    if effects is not None:
        values["effects"] = [] if effects == "none" else [name.strip() for name in effects.split(",")]
    if links:
        values["links"] = [name.strip() for name in links.split(",")]
    if known:
        values["known"] = list(known)
    return values


def _read_bag(
    path: Path, session: Session, topics: Topics, held_out_share: float, train: list[Samples], held_out: list[Samples]
) -> None:
    """Append a bag's samples to ``train``, those of the last share of its time to ``held_out``."""
    with Bag(path) as bag:
        batches = list(read_samples(bag, session, session.new_pipeline(), topics, tracked))
    first, last = int(batches[0].stamps[0]), int(batches[-1].stamps[-1])
    boundary = last + 1 - round(held_out_share * (last + 1 - first))
    for samples in batches:
        for target, chosen in ((train, samples.stamps < boundary), (held_out, samples.stamps >= boundary)):
            if np.any(chosen):
                target.append(samples.select(chosen))
