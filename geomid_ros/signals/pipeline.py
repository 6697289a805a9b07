"""From messages' numbers to samples: mapping, checks, alignment, filtering, differentiation.

The node and the bag reader feed one message after the other and collect what samples have become ready; both get the
same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.columns import NO_COLUMNS, Columns
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.joint_messages import JointReader, RejectedError, usable
from geomid_ros.signals.joint_parts import JointParts, Part
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.streams import Grid, JointSegment, PoseSegment, Stream, VectorSegment
from geomid_ros.signals.timeline import Read, Timeline, Turn
from geomid_ros.signals.velocity_choice import VelocityChoice
from geomid_ros.types import FloatArray

JOINT_STATES = "joint_states"
ODOM = "odom"
_PERIOD_ROUNDING = 10_000  # [ns] an inferred period is rounded to this
_MESSAGES_TO_INFER_PERIOD = 32
_MOST_WAITING = 10_000  # messages kept until the period is known
_HORIZON = 60_000_000_000  # [ns] a topic that falls behind the others by more is not waited for
_LONGEST_DELAY = 1.0  # [s] of efforts
_EFFORTS = "joint_states.effort"  # their stream, where they come late; no topic has that name

_Source: TypeAlias = tuple[str, Part]
"""A topic, and where joint messages are merged, the joints that a publisher has."""

Accepted: TypeAlias = tuple[str, int, FloatArray]
"""Topic, stamp [ns] and numbers of a message that was accepted, as the pipeline uses them."""


@dataclass(frozen=True)
class SignalSettings:
    """How signals are filtered, and what an effort number means.

    ``cutoff`` [Hz] of the low-pass; ``period`` [s] of the time grid, inferred from the first joint messages when 0;
    ``max_gap`` [s] a longer pause of a topic starts a new segment; ``effort_gain`` multiplies the messages' efforts to
    make N m (or N), one number for all joints or one by joint name (negative reverses the sign); ``effort_delay`` [s]
    says how long before its message's stamp an effort acted. ``merge``: each joint message has only some of the joints.
    """

    cutoff: float = 5.0
    period: float = 0.0
    max_gap: float = 0.5
    effort_gain: float | dict[str, float] = 1.0
    samples_per_cutoff_period: float = 8.0
    effort_delay: float = 0.0
    merge: bool = False

    def __post_init__(self) -> None:
        for name in ("cutoff", "max_gap", "samples_per_cutoff_period"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"signal setting {name} is {getattr(self, name)}, expected a number greater than zero")
        if self.period != 0.0 and not _PERIOD_ROUNDING * 1e-9 <= self.period < np.inf:
            raise InputError(f"signal setting period is {self.period}, expected 0 or at least {_PERIOD_ROUNDING} ns")
        if not abs(self.effort_delay) <= _LONGEST_DELAY:
            raise InputError(
                f"signal setting effort_delay is {self.effort_delay}, expected at most {_LONGEST_DELAY:g} s"
            )
        gains = self.effort_gain.values() if isinstance(self.effort_gain, dict) else (self.effort_gain,)
        if not all(np.isfinite(gain) and gain != 0.0 for gain in gains):
            raise InputError(f"effort gain {self.effort_gain}: expected finite numbers other than zero")


def ignore(*_: object) -> None:
    """Nobody wants to know."""


class SignalPipeline:
    """Feeds: :meth:`push_joints`, :meth:`push_base_pose`, :meth:`push_wrench`; result: :meth:`collect`."""

    def __init__(
        self,
        joints: Sequence[str],
        *,
        floating_base: bool = False,
        sensors: Sequence[WrenchSensor] = (),
        settings: SignalSettings = SignalSettings(),
        continuous: Sequence[str] = (),
        effect_columns: Columns = NO_COLUMNS,
        on_accepted: Callable[[str, int, FloatArray], None] = ignore,
        ledger: Ledger | None = None,
    ) -> None:
        """``ledger`` is told what becomes of every message; ``on_accepted`` of every one that is accepted, as
        :meth:`push_accepted` takes it.

        ``effect_columns`` are those that samples carry (:attr:`MeasurementModel.columns`).

        ``continuous`` names the joints without end: their positions may jump by whole turns between messages, and
        are given from -pi to pi in samples."""
        self._joints = tuple(joints)
        self._sensors = {sensor.topic: sensor for sensor in sensors}
        if len(self._sensors) < len(sensors) or {JOINT_STATES, ODOM} & set(self._sensors):
            topics = ", ".join(sensor.topic for sensor in sensors)
            raise InputError(f"wrench topics must differ from each other, '{JOINT_STATES}' and '{ODOM}': {topics}")
        self._floating_base = floating_base
        self._settings = settings
        self._max_gap = round(settings.max_gap * 1e9)
        self._effort_delay = round(settings.effort_delay * 1e9)
        self._effect_columns = effect_columns
        self._on_accepted = on_accepted
        self._continuous = np.array([joint in continuous for joint in self._joints], dtype=bool)
        self.ledger = ledger or Ledger()
        self._reader = self._new_reader(self._joints)
        self._parts = JointParts(self._joints, self._max_gap, self._new_reader) if settings.merge else None
        self._timelines: dict[_Source, Timeline] = {}
        self._velocity = VelocityChoice(len(self._joints))
        self._grid: Grid | None = None
        self._streams: dict[str, Stream[Any]] = {}
        self._waiting: deque[tuple[str, int, FloatArray]] = deque()
        self._first_stamps: deque[int] = deque(maxlen=_MESSAGES_TO_INFER_PERIOD)
        self._next_instant = 0
        self._pending: list[Samples] = []
        if settings.period > 0.0:
            self._start(round(settings.period * 1e9))

    def _new_reader(self, joints: Sequence[str]) -> JointReader:
        places = [self._joints.index(joint) for joint in joints]
        gains, continuous = self._effort_gains()[places], self._continuous[places]
        return JointReader(joints, gains, continuous, self._max_gap, partial(self.ledger.note, JOINT_STATES))

    def _effort_gains(self) -> FloatArray:
        gain = self._settings.effort_gain
        if not isinstance(gain, dict):
            return np.full(len(self._joints), float(gain))
        for name in gain:
            if name not in self._joints:
                raise unknown_name("joint with an effort gain", name, self._joints)
        return np.array([gain.get(name, 1.0) for name in self._joints])

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._grid.lag * self._grid.period * 1e-9 if self._grid is not None else 0.0

    @property
    def held(self) -> int:
        """Messages whose fate the next ones will tell."""
        return sum(timeline.held for timeline in list(self._timelines.values()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose efforts are left out, as they are not measured."""
        readers = self._parts.readers.values() if self._parts else (self._reader,)
        return tuple(joint for reader in readers for joint in reader.unmeasured)

    def push_joints(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> None:
        """Take a joint message with any order of joints; ``stamp`` in ns. What cannot be used is counted."""
        try:
            part = self._parts.part(names) if self._parts else ()
        except RejectedError as reason:
            self.ledger.reject(JOINT_STATES, str(reason))
            return
        reader = self._parts.readers[part] if self._parts else self._reader
        self._push((JOINT_STATES, part), stamp, lambda: reader.read(stamp, names, position, velocity, effort))

    def push_base_pose(self, stamp: int, pose: Sequence[float]) -> None:
        """Take the base's pose in the world, position [m] and quaternion xyzw."""
        self._push((ODOM, ()), stamp, lambda: _pose_vector(pose))

    def push_wrench(self, topic: str, stamp: int, frame: str, wrench: Sequence[float]) -> None:
        """Take force [N] and torque [N m] of a sensor's topic, expressed in ``frame`` (as the message says)."""
        if topic not in self._sensors:
            raise unknown_name("wrench topic", topic, self._sensors)
        self._push((topic, ()), stamp, lambda: _wrench_vector(self._sensors[topic], frame, wrench))

    def _push(self, source: _Source, stamp: int, read: Read) -> None:
        topic, _ = source
        verdict = self._timelines.setdefault(source, Timeline(self._max_gap)).judge(stamp, read)
        for reason in verdict.refused:
            self.ledger.reject(topic, reason)
        if verdict.turn is not Turn.CONTINUED:
            self.ledger.note(topic, verdict.turn.value)
        if verdict.turn is Turn.RESET:
            self._restart(source)
        todo = deque(verdict.use)
        try:
            while todo:
                self._use(source, *todo.popleft())
        except Exception as error:  # whoever called counts the message that caused it
            for _ in todo:
                self.ledger.drop(topic, f"{type(error).__name__} while another message was taken")
            raise

    def _use(self, source: _Source, stamp: int, read: Read) -> None:
        topic, part = source
        try:
            values = read()
        except RejectedError as reason:
            self.ledger.reject(topic, str(reason))
            return
        self._timelines[source].advance(stamp)
        for of_all, whole in self._parts.add(part, stamp, values) if self._parts and part else ((stamp, values),):
            self._on_accepted(topic, of_all, whole)
            self._forward(topic, of_all, whole)
        self.ledger.accept(topic)

    def push_accepted(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Take what another pipeline for the same robot has accepted, in the same order."""
        self._forward(topic, stamp, values)
        self.ledger.accept(topic)

    def _forward(self, topic: str, stamp: int, values: FloatArray) -> None:
        if self._grid is None:
            self._wait(topic, stamp, values)
        else:
            self._take(self._grid, topic, stamp, values)

    def release(self) -> None:
        """Reject what is held: nothing more will come."""
        for (topic, _), timeline in self._timelines.items():
            for reason in timeline.release():
                self.ledger.reject(topic, reason)

    def _restart(self, source: _Source) -> None:
        """Another time has begun, at ``source`` and therefore everywhere."""
        self._waiting.clear()
        self._first_stamps.clear()
        self._reader.restart()
        if self._parts:
            self._parts.restart()
        self._next_instant = 0
        if self._grid is not None:
            self._open_streams(self._grid)
        for other, timeline in self._timelines.items():
            if other != source:
                for held_stamp, held_read in timeline.forget():
                    self._use(other, held_stamp, held_read)

    def _wait(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Keep what arrives before the period is known."""
        self._waiting.append((topic, stamp, values))
        if len(self._waiting) > _MOST_WAITING:
            self.ledger.revoke(self._waiting.popleft()[0], "no joint states to go with")
        if topic == JOINT_STATES:
            self._first_stamps.append(stamp)
            if len(self._first_stamps) == _MESSAGES_TO_INFER_PERIOD:
                period = float(np.median(np.diff(self._first_stamps)))
                self._start(max(_PERIOD_ROUNDING, round(period / _PERIOD_ROUNDING) * _PERIOD_ROUNDING))

    def _take(self, grid: Grid, topic: str, stamp: int, values: FloatArray) -> None:
        """Pass values on and make what samples they complete."""
        parts = {topic: (stamp, values)}
        if topic == JOINT_STATES and self._effort_delay:
            parts[_EFFORTS] = (stamp - self._effort_delay, values[2 * len(self._joints) :])
        for name, part in parts.items():
            self._streams[name].push(*part)
        self._make_samples(grid)
        oldest = (stamp - _HORIZON - abs(self._effort_delay)) // grid.period - grid.lag
        for name in parts:
            self._streams[name].drop_before(oldest)

    def _start(self, period: int) -> None:
        grid = Grid(period, self._settings.cutoff, self._settings.samples_per_cutoff_period)
        self._grid = grid
        self._open_streams(grid)
        for topic, stamp, values in self._waiting:
            self._take(grid, topic, stamp, values)
        self._waiting.clear()

    def _open_streams(self, grid: Grid) -> None:
        def joint_segment() -> JointSegment:
            return JointSegment(grid, len(self._joints), self._effect_columns)

        self._joint_stream = Stream(self._max_gap, joint_segment)
        self._streams = {JOINT_STATES: self._joint_stream}
        self._streams |= {topic: Stream(self._max_gap, partial(VectorSegment, grid)) for topic in self._sensors}
        if self._effort_delay:
            self._streams[_EFFORTS] = Stream(self._max_gap, partial(VectorSegment, grid))
        if self._floating_base:
            self._streams[ODOM] = Stream(self._max_gap, partial(PoseSegment, grid))

    def collect(self) -> Samples | None:
        """The samples that have become ready since the last call, oldest first; None if there are none."""
        if not self._pending:
            return None
        samples = Samples.concatenate(self._pending)
        self._pending.clear()
        return samples

    def _make_samples(self, grid: Grid) -> None:
        """Make the samples for which every topic has the numbers; go on where one of them has paused."""
        streams = self._streams.values()
        while True:
            ranges = [stream.segment.ready() for stream in streams]
            start = max([self._next_instant, *(r.start for r in ranges)])
            instants = range(-(-start // grid.stride) * grid.stride, min(r.stop for r in ranges), grid.stride)
            if instants:
                self._pending.append(self._samples(grid, instants))
                self._next_instant = instants[-1] + 1
                for stream in streams:
                    stream.drop_before(self._next_instant)
            elif not any(stream.skip_to(instants.start) for stream in streams):
                break

    def _samples(self, grid: Grid, instants: range) -> Samples:
        count, joints = len(instants), len(self._joints)
        value, first, second = (
            part.reshape(count, 3, joints) for part in self._joint_stream.segment.filtered(instants)
        )
        position = value[:, 0]
        position[:, self._continuous] = np.remainder(position[:, self._continuous] + np.pi, 2.0 * np.pi) - np.pi
        velocity, acceleration = self._velocity.choose(value[:, 1], first[:, 1], first[:, 0], second[:, 0])
        effort = self._streams[_EFFORTS].segment.filtered(instants)[0] if self._effort_delay else value[:, 2]
        pose = base_velocity = base_acceleration = np.zeros((count, 0))
        if self._floating_base:
            pose, base_velocity, base_acceleration = self._streams[ODOM].segment.filtered(instants)
        wrenches = np.zeros((count, len(self._sensors), 6))
        for index, topic in enumerate(self._sensors):
            wrenches[:, index] = self._streams[topic].segment.filtered(instants)[0]
        stamps = np.array([instant * grid.period for instant in instants], dtype=np.int64)
        return Samples(
            stamps,
            position,
            velocity,
            acceleration,
            effort,
            pose,
            base_velocity,
            base_acceleration,
            wrenches,
            self._joint_stream.segment.effects(instants),
            self._effect_columns,
        )


def _pose_vector(pose: Sequence[float]) -> FloatArray:
    values = np.array(pose, dtype=np.float64)
    if not np.all(usable(values)):
        raise RejectedError("pose not finite")
    norm = float(np.linalg.norm(values[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise RejectedError("quaternion is not of length 1")
    values[3:] /= norm
    return values


def _wrench_vector(sensor: WrenchSensor, frame: str, wrench: Sequence[float]) -> FloatArray:
    declared = sensor.frame_id or sensor.frame
    if frame and frame != declared:
        raise RejectedError(f"frame '{frame}' is not the declared '{declared}'")
    values = np.array(wrench, dtype=np.float64)
    if not np.all(usable(values[sensor.axis_indices])):
        raise RejectedError("wrench not finite")
    return values - sensor.sign * np.array(sensor.offset)
