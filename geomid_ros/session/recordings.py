"""Samples from bags: what is fitted, and what is held out to judge on."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, silent
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.review import faulty_streams
from geomid_ros.session.session import Session
from geomid_ros.session.training import TrainingData
from geomid_ros.signals.decoding import Decoder
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, Accepted, message_type
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.unitree import KINDS

HELD_OUT = 0.3
"""Share of a recording's time, at the end, that is judged on unless the user says otherwise."""

_DESCRIPTION, _TEXT = "robot_description", "std_msgs/msg/String"
_WRENCH_OPTION = "--wrench, or wrench.*.topic in a parameter file,"


class NoSamplesError(InputError):
    """No samples can be made of a recording; with the joints ``lockable`` locked there may be some."""

    def __init__(self, message: str, lockable: tuple[str, ...]) -> None:
        super().__init__(message)
        self.lockable = lockable


@dataclass(frozen=True)
class Topics:
    """Topics that a recording is read from; ``joint_option`` is the option that names the joints'."""

    joint_states: str
    odom: str
    imu: str = IMU
    commands: str = COMMANDS
    joint_option: str = "--joint-topic"


@dataclass(frozen=True, kw_only=True)
class Bags:
    """Which bags to read, and how.

    Args:
        fitted: bags to fit.
        validate: bags to judge on.
        hold_out: share of each fitted bag's time, at the end, to judge on as well, 0 to 0.9; None for
            :data:`HELD_OUT`, or for nothing if there are bags to validate on.
        topics: topics of the joint states and of the base's pose or IMU.

    Raises:
        InputError: there is no bag, or one is given twice.
    """

    fitted: Sequence[Path]
    validate: Sequence[Path] = ()
    hold_out: float | None = None
    topics: Topics = Topics("joint_states", "odom")

    def __post_init__(self) -> None:
        if not self.fitted:
            raise InputError("no bag is given")
        every = Counter(path.resolve() for path in (*self.fitted, *self.validate))
        twice = next((path for path in (*self.fitted, *self.validate) if every[path.resolve()] > 1), None)
        if twice is not None:
            raise InputError(
                f"{twice}: given twice. Fit and test need different data; without --validate the end of each bag "
                "is held out"
            )

    @property
    def share(self) -> float:
        """Share of each fitted bag's time that is held out."""
        return self.hold_out if self.hold_out is not None else (0.0 if self.validate else HELD_OUT)

    @property
    def holds_out(self) -> bool:
        """Whether some data are not fitted, but judged on."""
        return bool(self.validate) or self.share > 0.0

    @property
    def shares(self) -> list[tuple[Path, float]]:
        """Every bag with the share of it that is held out."""
        return [*((path, self.share) for path in self.fitted), *((path, 1.0) for path in self.validate)]


def recorded_description(bags: Sequence[Path]) -> tuple[str, str]:
    """The robot description that was recorded beside the data.

    Returns:
        Its text, and where it is from: the topic and the bag.

    Raises:
        InputError: there is none, or there are several.
    """
    found: dict[str, str] = {}
    for path in bags:
        with Bag(path) as bag:
            topics = [topic for topic, kind in bag.topics.items() if kind == _TEXT and topic.endswith(_DESCRIPTION)]
            own = [topic for topic in topics if topic.lstrip("/") == _DESCRIPTION] or topics
            for topic, _, message in bag.messages(own):
                found.setdefault(message.data, f"{topic} in {path}")
    if len(found) == 1:
        ((text, source),) = found.items()
        return text, source
    named = ", ".join(map(str, bags))
    if found:
        raise InputError(f"{named}: several robot descriptions ({', '.join(found.values())}); choose one with --urdf")
    raise InputError(f"{named}: no robot description is recorded ({_DESCRIPTION}, {_TEXT}); name a file with --urdf")


def divided(batches: Sequence[Samples], share: float) -> list[tuple[Samples, Samples]]:
    """Divide one recording into what is fitted and what is held out.

    Args:
        batches: its samples in the order of time, in one piece or in several.
        share: how much of its time, at the end, is held out, 0 to 1.

    Returns:
        Of each piece the samples before and after the boundary; either may be empty.
    """
    boundary = _boundary(batches[0], batches[-1], share)
    return [_divided(samples, boundary) for samples in batches]


def _boundary(first: Samples, last: Samples, share: float) -> int:
    """The stamp [ns] before which samples of a recording are fitted. As it goes on this moves on."""
    end = int(last.stamps[-1]) + 1
    return end - round(share * (end - int(first.stamps[0])))


def _divided(samples: Samples, boundary: int) -> tuple[Samples, Samples]:
    """Both parts, without a copy where the clock was not set back meanwhile."""
    early = samples.stamps < boundary
    count = int(np.count_nonzero(early))
    if np.all(early[:count]):
        return samples.select(slice(count)), samples.select(slice(count, None))
    return samples.select(early), samples.select(~early)


def read_bags(
    session: Session, bags: Bags, fit: Callable[[Samples], object], progress: Progress = silent
) -> list[Samples]:
    """Read all bags with the session's settings.

    Args:
        session: takes note of what was read.
        bags: which, and how.
        fit: called with the samples to fit, in batches and in the order of time, as soon as that is sure: an hour of
            them does not have to be remembered.
        progress: told of it.

    Returns:
        The samples to judge on, in batches as they became ready.

    Raises:
        InputError: a bag cannot be used, or nothing is left to fit.
    """
    fitted = TrainingData(session, fit)
    held_out: list[Samples] = []
    for path in bags.fitted:
        pipeline = session.new_pipeline()
        kept: deque[Samples] = deque()
        boundary, first = 0, None
        for samples in _opened(path, session, pipeline, bags.topics, progress):
            session.review.check.add(samples)
            first = first or samples.select(slice(1))
            boundary = max(boundary, _boundary(first, samples, bags.share))
            kept.append(samples)
            while kept and kept[0].stamps[-1] < boundary:
                fitted.add(kept.popleft())
        session.pipeline.ledger.add(pipeline.ledger.topics)
        for samples in kept:
            early, late = _divided(samples, boundary)
            fitted.add(early)
            held_out += [late] if len(late) else []
    fitted.check(bags.fitted)
    session.review.judge()
    session.review.findings += fitted.standing()
    for path in bags.validate:
        pipeline, check = session.new_pipeline(), session.review.new_check()
        for samples in _opened(path, session, pipeline, bags.topics, progress):
            check.add(samples)
            held_out.append(samples)
        session.review.judge_validation(path.name, check, pipeline.ledger.topics)
        session.pipeline.ledger.add(pipeline.ledger.topics)
    if not held_out and bags.holds_out:
        raise InputError(f"{', '.join(map(str, bags.fitted))}: too short, no data left to test on")
    return held_out


def _opened(
    path: Path, session: Session, pipeline: SignalPipeline, topics: Topics, progress: Progress
) -> Iterator[Samples]:
    with Bag(path) as bag:
        yield from read_samples(bag, session, pipeline, topics, progress)


def read_fitted(session: Session, bags: Bags, progress: Progress = silent) -> list[Samples]:
    """As :func:`read_bags`, but the samples to fit, in batches; those to judge on are passed over."""
    samples: list[Samples] = []
    read_bags(session, bags, samples.append, progress)
    return samples


def read_samples(
    bag: Bag, session: Session, pipeline: SignalPipeline, topics: Topics, progress: Progress = silent
) -> Iterator[Samples]:
    """The samples of a recording, as they become ready. Raises InputError when there are none."""
    names = _resolved_topics(bag, session, topics)
    session.review.begin_recording(bag)
    total = bag.count(list(names))
    decoder = Decoder()
    done = ready = 0
    progress(f"reading {bag.path.name}", 0.0)
    unitree = session.unitree()
    for batch in bag.batches(list(names)):

        def refuse(place: int, why: str) -> None:
            topic, time, kind, _ = batch[place]  # noqa: B023 called at once
            raise bag.not_valid(topic, time, kind, why, done + place)  # noqa: B023

        origins, messages = unitree.read(batch, names, refuse)
        pipeline.push(decoder.blocks(messages, lambda place, why: refuse(origins[place], why)))  # noqa: B023
        done += len(batch)
        progress(f"reading {bag.path.name}", done / max(total, 1))
        samples = pipeline.collect()
        if samples is not None:
            ready += len(samples)
            yield samples
    pipeline.release()
    samples = pipeline.collect()
    if samples is not None:
        ready += len(samples)
        yield samples
    if ready == 0:
        raise NoSamplesError(_why_no_samples(bag, session, pipeline), session.lockable)


def samples_of_messages(
    pipeline: SignalPipeline, messages: Sequence[Accepted], stage: str, progress: Progress
) -> Samples | None:
    """The samples of messages that another pipeline has accepted; None if they are too few."""
    for index, message in enumerate(messages):
        progress(stage, index / len(messages))
        pipeline.push_accepted(message)
    return pipeline.collect()


def _resolved_topics(bag: Bag, session: Session, topics: Topics) -> dict[str, list[str]]:
    """The topics of the bag that are needed, and how the pipeline calls what is on each."""
    asked = {JOINT_STATES: (topics.joint_states, topics.joint_option)}
    if session.robot.floating_base:
        imu = session.base_topic == IMU
        asked[session.base_topic] = (topics.imu, "--imu") if imu else (topics.odom, "--odom-topic")
    if COMMANDS in session.topics:
        asked[COMMANDS] = (topics.commands, "--command")
    asked |= {sensor.topic: (sensor.topic, _WRENCH_OPTION) for sensor in session.model.sensors}
    found: dict[str, list[str]] = {}
    for own, (name, option) in asked.items():
        found.setdefault(bag.find_topic(name, message_type(own), option, KINDS.get(own, "")), []).append(own)
    return found


def _why_no_samples(bag: Bag, session: Session, pipeline: SignalPipeline) -> str:
    reasons = [
        f"{topic}: {count} of {account.received} messages rejected, {reason}"
        for topic, account in pipeline.ledger.topics.items()
        for reason, count in account.rejected.most_common(2)
    ]
    reasons += [finding.cause.sentence for finding in faulty_streams(pipeline.ledger.topics, {})]
    reasons += [f"{topic}: no messages" for topic in session.topics if topic not in pipeline.ledger.topics]
    if not reasons:
        short = f"it is shorter than the filter's window ({2 * pipeline.lag:.1f} s)"
        reasons = [f"{short} or its topics do not overlap; record half a minute of motion"]
    if any(meaning_of(why) == "frame" for account in pipeline.ledger.topics.values() for why in account.rejected):
        reasons.append("--wrench sets the frame of a wrench, wrench.*.frame_id the frame_id of its messages")
    why = f"{bag.path}: no usable samples. " + "; ".join(reasons)
    missing = not pipeline.joints_heard.issuperset(session.robot.joint_names)
    joints = f"The URDF's moving joints: {', '.join(session.robot.joint_names)}"
    end = "" if why.endswith("?") else "."
    return f"{why}{end} Or the recording is of another robot. {joints}" if missing else why


T = TypeVar("T")


def with_locked(configuration: Configuration, joints: Collection[str]) -> Configuration:
    """The configuration with these joints locked beside its own."""
    return configuration.with_values({"locked_joints": [*configuration["locked_joints"], *joints]})


def locked_note(joints: Iterable[str]) -> str:
    """The sentence on joints that were locked as they are in no message."""
    named = ", ".join(map(repr, joints))
    return f"no message names {named}: locked at zero, as with locked_joints (--lock)"


def read_with_locked(
    make: Callable[[Configuration], Session], configuration: Configuration, read: Callable[[Session], T]
) -> tuple[Session, T]:
    """Read recordings; if they lack joints that may be locked, once more with these locked.

    Args:
        make: makes the session of a configuration.
        configuration: to begin with.
        read: reads the recordings for a session.

    Returns:
        The session, and what was read for it.

    Raises:
        InputError: the recordings cannot be used.
    """
    session = make(configuration)
    try:
        found = read(session)
    except NoSamplesError as error:
        if not error.lockable:
            raise
        session = make(with_locked(configuration, error.lockable))
        found = read(session)
    locked = [joint for joint in session.locked_joints if joint not in configuration["locked_joints"]]
    if heard := session.joints_heard.intersection(locked):
        raise InputError(
            f"joint '{min(heard)}' is missing in the messages of some recordings, or of those of the model, and not of "
            "others; use those that have it, or name it in the parameter locked_joints (--lock)"
        )
    if locked:
        session.review.settled.append(locked_note(locked))
    return session, found
