"""``geomid identify``: link inertias from rosbags."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from geomid_ros.commands.progress import tracked, working
from geomid_ros.commands.tables import print_estimate
from geomid_ros.errors import InputError
from geomid_ros.files.bags import Bag
from geomid_ros.files.configuration import Configuration
from geomid_ros.files.report.drawing import draw_identification
from geomid_ros.files.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.session import Session
from geomid_ros.signals.messages import MESSAGE_TYPES, feed_joint_state, feed_odometry, feed_wrench
from geomid_ros.signals.pipeline import SignalPipeline


@dataclass(frozen=True)
class Topics:
    """Topics that a recording is read from."""

    joint_states: str
    odom: str


def configuration_options(command: Any) -> Any:
    """The options that say which robot, what is measured on it, and how: shared by commands that read bags."""
    for option in (
        click.option("--odom-topic", default="odom", show_default=True, help="Topic of the base's pose."),
        click.option("--joint-topic", default="joint_states", show_default=True, help="Topic of the joint states."),
        click.option(
            "--wrench",
            multiple=True,
            metavar="TOPIC:FRAME:ROLE[:AXES]",
            help="A wrench topic; ROLE is mounted or external, -ROLE reverses its sign; AXES like fz,tx,ty.",
        ),
        click.option("--floating-base", is_flag=True, help="The base moves; its pose is read from the odometry topic."),
        click.option("--links", help="Identify only these links, separated by commas."),
        click.option("--effects", help="Identify these effects, separated by commas; 'none' for none."),
        click.option("--model", type=click.Path(path_type=Path), help="Start from this estimate.json."),
        click.option("--config", type=click.Path(path_type=Path), help="The node's parameter file (YAML)."),
        click.option("--urdf", type=click.Path(path_type=Path), required=True, help="The robot's description."),
    ):
        command = option(command)
    return command


def configured(
    config: Path | None,
    model: Path | None,
    effects: str | None,
    links: str | None,
    floating_base: bool,
    wrench: tuple[str, ...],
) -> Configuration:
    """The configuration of a parameter file and of options, which win."""
    configuration = Configuration.read(config) if config else Configuration(source="options")
    values: dict[str, Any] = {}
    if model:
        values["model"] = str(model)
    if effects is not None:
        values["effects"] = [] if effects == "none" else [name.strip() for name in effects.split(",")]
    if links:
        values["links"] = [name.strip() for name in links.split(",")]
    if floating_base:
        values["floating_base"] = True
    if wrench:
        configuration = configuration.with_sensors([WrenchSensor.parse(text) for text in wrench])
    return configuration.with_values(Configuration(values, "options").given)


def read_samples(bag: Bag, session: Session, pipeline: SignalPipeline, topics: Topics) -> Iterator[Samples]:
    """The samples of a recording, as they become ready. Raises InputError when there are none."""
    names = _resolved_topics(bag, session, topics)
    messages = bag.messages(list(names))
    ready = 0
    for topic, _, message in tracked(messages, bag.count(list(names)), f"reading {bag.path.name}"):
        kind, name = names[topic]
        if kind == "joint_states":
            feed_joint_state(pipeline, message)
        elif kind == "odom":
            feed_odometry(pipeline, message)
        else:
            feed_wrench(pipeline, name, message)
        samples = pipeline.collect()
        if samples is not None:
            ready += len(samples)
            yield samples
    if ready == 0:
        raise InputError(_why_no_samples(bag, session, pipeline))


def _resolved_topics(bag: Bag, session: Session, topics: Topics) -> dict[str, tuple[str, str]]:
    """Kind and declared name of each topic of the bag that is needed."""
    names = {bag.find_topic(topics.joint_states, MESSAGE_TYPES["joint_states"], "--joint-topic"): ("joint_states", "")}
    if session.robot.floating_base:
        names[bag.find_topic(topics.odom, MESSAGE_TYPES["odom"], "--odom-topic")] = ("odom", "")
    for sensor in session.model.sensors:
        names[bag.find_topic(sensor.topic, MESSAGE_TYPES["wrench"], "--wrench")] = ("wrench", sensor.topic)
    return names


def _why_no_samples(bag: Bag, session: Session, pipeline: SignalPipeline) -> str:
    reasons = [
        f"{topic}: {count} of {ledger.received} messages refused, {reason}"
        for topic, ledger in pipeline.ledgers.items()
        for reason, count in ledger.rejected.most_common(2)
    ]
    reasons += [f"{topic}: no messages" for topic in session.topics if topic not in pipeline.ledgers]
    if not reasons:
        reasons = [f"it is shorter than the filter's window ({2 * pipeline.lag:.1f} s) or its topics do not overlap"]
    joints = ", ".join(session.robot.joint_names)
    return f"{bag.path}: no usable samples. " + "; ".join(reasons) + f". The URDF's moving joints: {joints}"


@click.command()
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
@configuration_options
@click.option(
    "--hold-out",
    type=click.FloatRange(0.0, 0.9),
    help="Share of each bag's time, at the end, kept to test on.  [default: 0.3, with --validate 0]",
)
@click.option("--validate", multiple=True, type=click.Path(path_type=Path), help="A bag to test on; may be repeated.")
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
    configuration = configured(config, model, effects, links, floating_base, wrench)
    session = Session(read_urdf(urdf), configuration, str(urdf))
    topics = Topics(joint_topic, odom_topic)
    share = hold_out if hold_out is not None else (0.0 if validate else 0.3)
    held_out: list[Samples] = []
    train: list[Samples] = []
    for path in bags:
        _read_bag(path, session, topics, share, train, held_out)
    for path in validate:
        _read_bag(path, session, topics, 1.0, train, held_out)
    if not train:
        raise InputError(f"{', '.join(map(str, bags))}: too short, nothing is left to identify from")
    _check_efforts(session, train, bags)
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
        click.echo(f"\nWritten: {out / 'estimate.json'}, {out / 'identified.urdf'}, {picture}")


def _read_bag(
    path: Path, session: Session, topics: Topics, held_out_share: float, train: list[Samples], held_out: list[Samples]
) -> None:
    """Append a bag's samples to ``train``, those of the last share of its time to ``held_out``."""
    with Bag(path) as bag:
        batches = list(read_samples(bag, session, session.new_pipeline(), topics))
    first, last = int(batches[0].stamps[0]), int(batches[-1].stamps[-1])
    boundary = last + 1 - round(held_out_share * (last + 1 - first))
    for samples in batches:
        for target, chosen in ((train, samples.stamps < boundary), (held_out, samples.stamps >= boundary)):
            if np.any(chosen):
                target.append(samples.select(chosen))


def _check_efforts(session: Session, train: list[Samples], bags: tuple[Path, ...]) -> None:
    """Refuse data in which nothing that the model predicts was measured."""
    if all(np.all(np.isnan(session.model.rows(samples).targets)) for samples in train):
        channels = ", ".join(channel.name for channel in session.model.channels)
        raise InputError(
            f"{', '.join(map(str, bags))}: no effort is measured (empty or NaN throughout), and no wrench is declared "
            f"with --wrench. At least one of these channels is needed: {channels}"
        )
