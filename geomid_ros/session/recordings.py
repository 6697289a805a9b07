"""Samples from bags."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.samples import Samples
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, ODOM, message_type, parse
from geomid_ros.signals.pipeline import SignalPipeline

Tracked: TypeAlias = Callable[[Iterable[Any], int, str], Iterable[Any]]
"""Passes items on and shows how many of a total are done, under a description."""


def untracked(items: Iterable[Any], total: int, description: str) -> Iterable[Any]:  # noqa: ARG001
    """Shows nothing."""
    return items


@dataclass(frozen=True)
class Topics:
    """Topics that a recording is read from; ``joint_option`` is the option that names the joints'."""

    joint_states: str
    odom: str
    joint_option: str = "--joint-topic"


def read_samples(
    bag: Bag, session: Session, pipeline: SignalPipeline, topics: Topics, tracked: Tracked = untracked
) -> Iterator[Samples]:
    """The samples of a recording, as they become ready. Raises InputError when there are none."""
    names = _resolved_topics(bag, session, topics)
    messages = bag.messages(list(names))
    ready = 0
    for topic, _, message in tracked(messages, bag.count(list(names)), f"reading {bag.path.name}"):
        pipeline.push(parse(names[topic], message))
        samples = pipeline.collect()
        if samples is not None:
            ready += len(samples)
            yield samples
    if ready == 0:
        raise InputError(_why_no_samples(bag, session, pipeline))


def _resolved_topics(bag: Bag, session: Session, topics: Topics) -> dict[str, str]:
    """The topics of the bag that are needed, and how the pipeline calls each."""
    asked = {JOINT_STATES: (topics.joint_states, topics.joint_option)}
    if session.robot.floating_base:
        asked[ODOM] = (topics.odom, "--odom-topic")
    asked |= {sensor.topic: (sensor.topic, "--wrench") for sensor in session.model.sensors}
    return {bag.find_topic(name, message_type(own), option): own for own, (name, option) in asked.items()}


def _why_no_samples(bag: Bag, session: Session, pipeline: SignalPipeline) -> str:
    reasons = [
        f"{topic}: {count} of {account.received} messages refused, {reason}"
        for topic, account in pipeline.ledger.topics.items()
        for reason, count in account.rejected.most_common(2)
    ]
    reasons += [f"{topic}: no messages" for topic in session.topics if topic not in pipeline.ledger.topics]
    if not reasons:
        reasons = [f"it is shorter than the filter's window ({2 * pipeline.lag:.1f} s) or its topics do not overlap"]
    joints = ", ".join(session.robot.joint_names)
    return f"{bag.path}: no usable samples. " + "; ".join(reasons) + f". The URDF's moving joints: {joints}"


def check_efforts(session: Session, train: Sequence[Samples], bags: Sequence[Path]) -> None:
    """Refuse data in which nothing that the model predicts was measured."""
    if all(np.all(np.isnan(session.model.rows(samples).targets)) for samples in train):
        channels = ", ".join(channel.name for channel in session.model.channels)
        raise InputError(
            f"{', '.join(map(str, bags))}: no effort is measured (empty or NaN throughout), and no wrench is declared "
            f"with --wrench. At least one of these channels is needed: {channels}"
        )
