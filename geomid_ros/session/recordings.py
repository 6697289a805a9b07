"""Samples from bags, divided into data to fit and held-out data; the former on their way to the identifier, and their
checks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.wrench_sensors import FirstForces
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.moving_base import Legs
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import sensor_channels
from geomid_ros.options import Progress, silent
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.review import LeftOut, faulty_streams
from geomid_ros.session.session import Session
from geomid_ros.session.unloaded import Unloaded
from geomid_ros.signals.ledger import meaning_of
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, AcceptedMessages, Decoder, message_type
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import MOST_WAITING_BYTES
from geomid_ros.signals.unitree import KINDS

HELD_OUT = 0.3
"""Default fraction of a recording's time, at the end, that is held out."""

_DESCRIPTION, _TEXT = "robot_description", "std_msgs/msg/String"
_WRENCH_OPTION = "--wrench, or wrench.*.topic in a parameter file,"


class NoSamplesError(InputError):
    """No samples can be made of a recording; locking the joints ``lockable`` may help."""

    def __init__(self, message: str, lockable: tuple[str, ...]) -> None:
        super().__init__(message)
        self.lockable = lockable


@dataclass(frozen=True)
class Topics:
    """Topics that a recording is read from; ``joint_option`` is the command-line option for the joints' topic."""

    joint_states: str
    odom: str
    imu: str = IMU
    commands: str = COMMANDS
    joint_option: str = "--joint-topic"


@dataclass(frozen=True, kw_only=True)
class Bags:
    """Bags to read, and how to read them.

    Args:
        fitted: bags to fit.
        validate: bags to evaluate on.
        hold_out: fraction of each fitted bag's time, at the end, to evaluate on as well, 0 to 0.9; None for
            :data:`HELD_OUT`, or for nothing if there are bags to validate on.
        topics: topics of the joint states and of the base's pose or IMU.
        unloaded: True to leave out what is recorded while a payload is carried (:class:`Unloaded`).
        left_out: parts that are left out in any case.

    Raises:
        InputError: there is no bag, or one is given twice.
    """

    fitted: Sequence[Path]
    validate: Sequence[Path] = ()
    hold_out: float | None = None
    topics: Topics = Topics("joint_states", "odom")
    unloaded: bool = False
    left_out: Sequence[LeftOut] = ()

    def __post_init__(self) -> None:
        if not self.fitted:
            raise InputError("no bag is given")
        counts = Counter(path.resolve() for path in self.all)
        duplicate = next((path for path in self.all if counts[path.resolve()] > 1), None)
        if duplicate is not None:
            raise InputError(
                f"{duplicate}: given twice. Fit and test need different data; without --validate the end of each bag "
                "is held out"
            )

    @property
    def all(self) -> tuple[Path, ...]:
        """All bags."""
        return (*self.fitted, *self.validate)

    @property
    def held_out_fraction(self) -> float:
        """Fraction of each fitted bag's time that is held out."""
        return self.hold_out if self.hold_out is not None else (0.0 if self.validate else HELD_OUT)

    @property
    def holds_out(self) -> bool:
        """True if some data are not fitted, but held out."""
        return bool(self.validate) or self.held_out_fraction > 0.0

    @property
    def held_out_fractions(self) -> list[tuple[Path, float]]:
        """Every bag with the fraction of it that is held out."""
        return [*((path, self.held_out_fraction) for path in self.fitted), *((path, 1.0) for path in self.validate)]

    def kept(self, path: Path, samples: Samples) -> Samples:
        """Return the samples of a bag that are not left out."""
        kept = np.ones(len(samples), dtype=bool)
        for part in self.left_out:
            if part.path == path:
                kept &= (samples.stamps < part.begin) | (samples.stamps >= part.end)
        return samples if np.all(kept) else samples.select(kept)


def recorded_description(bags: Sequence[Path]) -> tuple[str, str]:
    """Find the robot description that was recorded with the data.

    Returns:
        Its text, and its origin: the topic and the bag.

    Raises:
        InputError: there is none, or there are several.
    """
    sources: dict[str, str] = {}
    for path in bags:
        with Bag(path) as bag:
            topics = [topic for topic, kind in bag.topics.items() if kind == _TEXT and topic.endswith(_DESCRIPTION)]
            chosen = [topic for topic in topics if topic.lstrip("/") == _DESCRIPTION] or topics
            for topic, _, message in bag.messages(chosen):
                sources.setdefault(message.data, f"{topic} in {path}")
    if len(sources) == 1:
        ((text, source),) = sources.items()
        return text, source
    names = ", ".join(map(str, bags))
    if sources:
        raise InputError(f"{names}: several robot descriptions ({', '.join(sources.values())}); choose one with --urdf")
    raise InputError(f"{names}: no robot description is recorded ({_DESCRIPTION}, {_TEXT}); name a file with --urdf")


def split_held_out(samples: Samples, share: float) -> tuple[Samples, Samples]:
    """Divide a recording into samples to fit and held-out ones, either of which may be empty. ``share``: fraction of
    its time, at the end, that is held out, 0 to 1."""
    return _divided(samples, _boundary(samples, samples, share))


def _boundary(first: Samples, last: Samples, share: float) -> int:
    """Stamp [ns] before which samples of a recording are fitted. It moves on as the recording proceeds."""
    end = int(last.stamps[-1]) + 1
    return end - round(share * (end - int(first.stamps[0])))


def _divided(samples: Samples, boundary: int) -> tuple[Samples, Samples]:
    """Samples before and after the boundary, without a copy unless the clock was set back."""
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
        session: records what was read.
        bags: the bags, and how to read them.
        fit: called with samples to fit, in batches and in the order of time, as soon as they are certain to be fitted:
            an hour of samples need not be kept in memory.
        progress: called with the progress.

    Returns:
        The held-out samples, in batches as they became ready.

    Raises:
        InputError: a bag cannot be used, or no data to fit remain.
    """
    fitted = TrainingData(session, fit)
    held_out: list[Samples] = []
    watch = Unloaded(session) if bags.unloaded else None

    def read(path: Path, bag: Bag, pipeline: SignalPipeline) -> Iterator[Samples]:
        recording = read_samples(bag, session, pipeline, bags.topics, progress)
        kept = filter(len, map(partial(bags.kept, path), recording))
        return kept if watch is None else watch(path, kept)

    for path in bags.fitted:
        pipeline = session.new_pipeline()
        kept: deque[Samples] = deque()
        boundary, first = 0, None
        with Bag(path) as bag:
            for samples in read(path, bag, pipeline):
                session.review.check.add(samples)
                first = first or samples.select(slice(1))
                boundary = max(boundary, _boundary(first, samples, bags.held_out_fraction))
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
    session.review.findings += fitted.standstill_findings()
    for path in bags.validate:
        pipeline, check = session.new_pipeline(), session.review.new_check()
        check.begin_recording(path.name)
        with Bag(path) as bag:
            for samples in read(path, bag, pipeline):
                check.add(samples)
                held_out.append(samples)
        session.review.judge_validation(path.name, check, pipeline.ledger.topics)
        session.pipeline.ledger.add(pipeline.ledger.topics)
    session.review.left_out = (*bags.left_out, *(watch.left_out if watch else ()))
    if not held_out and bags.holds_out:
        why = [part.sentence for part in session.review.left_out] or ["too short"]
        tested = ", ".join(map(str, bags.validate or bags.fitted))
        raise InputError(f"{tested}: no data left to test on: {'; '.join(why)}")
    return held_out


def train(
    session: Session, bags: Bags, progress: Progress = silent, note: Callable[[Samples], object] = lambda _: None
) -> list[Samples]:
    """Like :func:`read_bags`, with the samples to fit given to the session's identifier, then to ``note``."""
    training = Training(session)

    def fit(samples: Samples) -> None:
        training.add(samples)
        note(samples)

    held_out = read_bags(session, bags, fit, progress)
    training.end()
    return held_out


def read_fitted(session: Session, bags: Bags, progress: Progress = silent) -> list[Samples]:
    """Like :func:`read_bags`, but return the samples to fit, in batches; the held-out ones are discarded."""
    samples: list[Samples] = []
    read_bags(session, bags, samples.append, progress)
    return samples


def read_samples(
    bag: Bag, session: Session, pipeline: SignalPipeline, topics: Topics, progress: Progress = silent
) -> Iterator[Samples]:
    """Yield the samples of a recording as they become ready. Raises InputError if there are none."""
    names = _resolved_topics(bag, session, topics)
    session.review.begin_recording(bag)
    total = bag.count(list(names))
    decoder = Decoder()
    done = ready = 0
    progress(f"reading {bag.path.name}", 0.0)
    unitree = session.unitree()
    for batch in chain(bag.batches(list(names)), [[]]):  # the last one is empty

        def refuse(place: int, reason: str) -> None:
            topic, time, kind, _ = batch[place]  # noqa: B023 called at once
            raise bag.not_valid(topic, time, kind, reason, done + place)  # noqa: B023

        origins, messages = unitree.read(batch, names, refuse)
        pipeline.push(decoder.blocks(messages, lambda place, reason: refuse(origins[place], reason)))  # noqa: B023
        done += len(batch)
        progress(f"reading {bag.path.name}", done / max(total, 1))
        if not batch:
            pipeline.release()
        if (samples := pipeline.collect()) is not None:
            ready += len(samples)
            yield samples
    if ready == 0:
        raise NoSamplesError(_why_no_samples(bag, session, pipeline), session.lockable)


def samples_of_messages(
    pipeline: SignalPipeline, messages: Sequence[AcceptedMessages], stage: str, progress: Progress
) -> Samples | None:
    """Samples of messages accepted by another pipeline; None if they are too few."""
    for index, message in enumerate(messages):
        progress(stage, index / len(messages))
        pipeline.push_accepted(message)
    return pipeline.collect()


def _resolved_topics(bag: Bag, session: Session, topics: Topics) -> dict[str, list[str]]:
    """Topics of the bag that are needed, with the pipeline's names for each."""
    requested = {JOINT_STATES: (topics.joint_states, topics.joint_option)}
    if session.robot.floating_base:
        imu = session.base_topic == IMU
        requested[session.base_topic] = (topics.imu, "--imu") if imu else (topics.odom, "--odom-topic")
    if COMMANDS in session.topics:
        requested[COMMANDS] = (topics.commands, "--command")
    requested |= {sensor.topic: (sensor.topic, _WRENCH_OPTION) for sensor in session.model.sensors}
    resolved: dict[str, list[str]] = {}
    for role, (name, option) in requested.items():
        resolved.setdefault(bag.find_topic(name, message_type(role), option, KINDS.get(role, ())), []).append(role)
    return resolved


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
    meanings = {meaning_of(text) for account in pipeline.ledger.topics.values() for text in account.rejected}
    if "frame" in meanings:
        reasons.append("--wrench sets the frame of a wrench, wrench.*.frame_id the frame_id of its messages")
    text = f"{bag.path}: no usable samples. " + "; ".join(reasons)
    names = session.robot.joint_names
    absent = [name for name in names if name not in session.received_joints]
    joints = f"The URDF's moving joints: {', '.join(names)}; in no message: {','.join(absent)}"
    end = "" if text.endswith("?") else "."
    return f"{text}{end} Or the recording is of another robot. {joints}" if "joint" in meanings else text


T = TypeVar("T")


def with_locked(configuration: Configuration, joints: Collection[str]) -> Configuration:
    """Return the configuration with these joints locked in addition to its own."""
    return configuration.with_values({"locked_joints": [*configuration["locked_joints"], *joints]})


def locked_note(joints: Iterable[str]) -> str:
    """Sentence on joints that were locked because no message contains them."""
    listing = ", ".join(map(repr, joints))
    return f"no message names {listing}: locked at zero, as with locked_joints (--lock)"


def read_with_locked(
    make: Callable[[Configuration], Session], configuration: Configuration, read: Callable[[Session], T]
) -> tuple[Session, T]:
    """Read recordings. If they lack joints that may be locked, lock these and read again.

    Args:
        make: makes the session of a configuration.
        configuration: the initial configuration.
        read: reads the recordings for a session.

    Returns:
        The session, and the result of ``read`` for it.

    Raises:
        InputError: the recordings cannot be used.
    """
    session = make(configuration)
    try:
        result = read(session)
    except NoSamplesError as error:
        if not error.lockable:
            raise
        session = make(with_locked(configuration, error.lockable))
        result = read(session)
    locked = [joint for joint in session.locked_joints if joint not in configuration["locked_joints"]]
    if received := session.received_joints.intersection(locked):
        raise InputError(
            f"joint '{min(received)}' is missing in some recordings, or in those of the model, but not in others; use "
            "those that have it, or name it in the parameter locked_joints (--lock)"
        )
    if locked:
        session.review.settled.append(locked_note(locked))
    return session, result


def check_measured(session: Session, train: Iterable[Samples], bags: Sequence[Path]) -> None:
    """Refuse data without samples, or without a measurement that the model predicts.

    Raises:
        InputError: it names the ``bags`` that the data are from.
    """
    fitted = TrainingData(session)
    for samples in train:
        fitted.add(samples)
    fitted.check(bags)


class TrainingData:
    """Passes on the samples to fit, and checks that they can be fitted."""

    def __init__(self, session: Session, fit: Callable[[Samples], object] = lambda _: None) -> None:
        """
        Args:
            session: the session that fits them.
            fit: called with the samples.
        """
        self._session = session
        self._fit = fit
        self._any = self._measured = False
        self._standing: Samples | None = None  # the first samples with a foot on the ground
        self._low, self._high = np.inf, -np.inf  # range of positions, by joint

    def add(self, samples: Samples) -> None:
        """Pass on samples, if there are any."""
        if not len(samples):
            return
        self._any = True
        targets = (self._session.model.rows(piece).targets for piece in samples.in_pieces())
        self._measured = self._measured or any(not np.all(np.isnan(each)) for each in targets)
        if self._standing is None and np.any(samples.standing):
            self._standing = samples
        self._low = np.minimum(self._low, np.min(samples.position, axis=0))
        self._high = np.maximum(self._high, np.max(samples.position, axis=0))
        self._fit(samples)

    def check(self, bags: Sequence[Path]) -> None:
        """Refuse the data like :func:`check_measured`."""
        files = ", ".join(map(str, bags))
        if not self._any:
            raise InputError(f"{files}: too short, no data left to identify from")
        legs = self._session.model.legs
        if legs is not None and self._standing is None:
            feet = ", ".join(contact.frame for contact in legs.contacts)
            raise InputError(
                f"{files}: leg efforts show no ground contact at feet {feet}. If the robot stands, check that efforts "
                "are in N m (--gain); if it hangs or lies on a stand, leave out --imu and --contacts"
            )
        if legs is not None and self._standing is not None and not self._measured:
            raise InputError(f"{files}: {_no_ground_forces(self._session.model.robot, legs, self._standing)}")
        if not self._measured:
            channels = ", ".join(channel.name for channel in self._session.model.channels)
            raise InputError(
                f"{files}: no effort is measured (empty, NaN or zero throughout), and no wrench is declared with "
                f"--wrench. At least one of these channels is needed: {channels}. Let the driver publish efforts, or "
                "record a wrench sensor"
            )

    def standstill_findings(self) -> tuple[RecordingFault, ...]:
        """One finding if the robot does not move in the data to fit, else none."""
        largest = float(np.max(self._high - self._low, initial=0.0))
        if self._session.robot.floating_base or largest >= self._session.configuration["still_distance"]:
            return ()
        sentence = (
            f"the robot is at rest: no joint moves by more than {largest:.2g} (rad, m), which contains almost no "
            "information"
        )
        return (RecordingFault(cause=Cause(kind="still", sentence=f"{sentence}; record a motion of all joints")),)


def _no_ground_forces(robot: Robot, legs: Legs, standing: Samples) -> str:
    """Sentence on why the efforts never determine the forces of the ground; a foot stands in some of the samples."""
    measured = np.any(np.isfinite(standing.effort), axis=0)
    missing = [robot.joint_names[joint] for joints in legs.joints for joint in joints if not measured[joint]]
    if missing:
        return (
            f"no efforts are measured at {', '.join(missing)}, so that ground reaction forces are unknown. Let the "
            "driver publish the efforts of all joints, or compute them from set-points: --command TOPIC with --gains "
            "KP:KD"
        )
    feet = zip(legs.contacts, legs.standing(standing), strict=True)
    blind = [contact.frame for contact, (_, rows, onto_base) in feet if len(rows) and np.all(np.isnan(onto_base))]
    return (
        f"ground reaction forces on {', '.join(blind) or 'the feet'} are not identifiable from the efforts in any "
        "sample: the joints do not move these links in three directions. Name the links that touch the ground "
        "(--contacts), not those at a knee; if they are the feet, the legs are always stretched: bend them"
    )


class Training:
    """Gives samples to a session's identifier. Checks its mounted wrench sensors once, by the first rows that it took,
    and leaves out the rows of those that are not as declared."""

    def __init__(self, session: Session, watched: bool = False) -> None:
        """Begin with the session's next samples. ``watched``: rows may be left out because of a payload, too."""
        self._session, self._watched = session, watched
        self._sensors = sensor_channels(session.model)
        self._check = FirstForces(session.model, session.model.nominal_parameters)
        self._keep_revocable()

    def add(self, samples: Samples) -> None:
        """Add samples."""
        for piece in samples.in_pieces():
            _, rows, _ = self._session.identifier.add(piece)
            self.check(rows)

    def end(self) -> None:
        """Add findings on the sensors that are not as declared to the session's review."""
        reported = {place for finding in self._session.review.findings for place in finding.cause.places}
        self._session.review.findings += tuple(
            RecordingFault(cause=Cause(kind="wrench", sentence=sentence, places=(topic,)))
            for topic, sentence in self.sentences.items()
            if topic not in reported
        )

    @property
    def sentences(self) -> dict[str, str]:
        """Fault of each sensor that is not as declared, by its topic."""
        return {topic: f"{topic}: {problem} Its rows are left out" for topic, problem in self._check.problems.items()}

    def check(self, rows: Rows) -> bool:
        """Check the sensors by rows that were taken, and leave out the rows of faulty sensors.

        Returns:
            True if any were left out.
        """
        if self._check.ended:
            return False
        self._check.add(rows)
        for topic in self._check.problems:
            self._session.identifier.leave_out(f"wrench doubtful: {topic}", self._sensors[topic], 0)
        self._keep_revocable()
        return bool(self._check.problems)

    def without_doubtful(self, rows: Rows) -> Rows:
        """Rows without those of faulty sensors."""
        targets = rows.targets.copy()
        targets[:, [place for topic in self._check.problems for place in self._sensors[topic]]] = np.nan
        return Rows(rows.coefficients, targets)

    def _keep_revocable(self) -> None:
        """Keep rows revocable while their sensors may still prove to be faulty, or a payload to have been carried."""
        model = self._session.model
        forgets = np.isfinite(self._session.configuration.buffer.forgetting_time)
        bytes_per_sample = 8 * (model.dimension + 1) * len(model.channels)
        revocable = self._watched or (model.mounted and not (forgets and self._check.ended))
        self._session.identifier.buffer_last(MOST_WAITING_BYTES // bytes_per_sample if revocable else 0)
