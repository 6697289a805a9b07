"""From messages' numbers to samples: mapping, checks, alignment, filtering, differentiation.

The node and the bag reader feed one message after the other and collect what samples have become ready; both get the
same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.streams import EffectColumns, Grid, JointStream, PoseStream, Stream, VectorStream
from geomid_ros.signals.velocity_choice import VelocityChoice
from geomid_ros.types import BoolArray, FloatArray, IntArray

JOINT_STATES = "joint_states"
ODOM = "odom"
_PERIOD_ROUNDING = 10_000  # [ns] an inferred period is rounded to this
_MESSAGES_TO_INFER_PERIOD = 32
_MOST_WAITING = 10_000  # messages kept until the period is known
_HORIZON = 60_000_000_000  # [ns] a topic that falls behind the others by more is not waited for
_LATE_MESSAGES_OF_A_RESET_CLOCK = 10
_LONGEST_DELAY = 1.0  # [s] of efforts
_EFFORTS = "joint_states.effort"  # their stream, where they come late; no topic has that name
_LARGEST_NUMBER = 1e9  # in SI units; no robot measures more

Accepted: TypeAlias = tuple[str, int, FloatArray]
"""Topic, stamp [ns] and numbers of a message that was accepted, as the pipeline uses them."""


@dataclass(frozen=True)
class SignalSettings:
    """How signals are filtered, and what an effort number means.

    ``cutoff`` [Hz] of the low-pass; ``period`` [s] of the time grid, inferred from the first joint messages when 0;
    ``max_gap`` [s] a longer pause of a topic starts a new segment; ``effort_gain`` multiplies the messages' efforts to
    make N m (or N), one number for all joints or one by joint name (negative reverses the sign); ``effort_delay`` [s]
    says how long before its message's stamp an effort acted.
    """

    cutoff: float = 5.0
    period: float = 0.0
    max_gap: float = 0.5
    effort_gain: float | dict[str, float] = 1.0
    samples_per_cutoff_period: float = 8.0
    effort_delay: float = 0.0

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


@dataclass
class Ledger:
    """What became of the messages of a topic: ``received = accepted + sum(rejected)``."""

    received: int = 0
    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)


class _RejectedError(Exception):
    """A message that cannot be used; its text is the reason that is counted."""


def ignore(*_: object) -> None:
    """Nobody wants to know."""


def no_effects(position: FloatArray, *_: FloatArray) -> FloatArray:
    """Columns of no effects."""
    return np.zeros((*position.shape, 0))


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
        effect_columns: EffectColumns = no_effects,
        on_accepted: Callable[[str, int, FloatArray], None] = ignore,
    ) -> None:
        """``on_accepted`` is told of every message that is accepted, as :meth:`push_accepted` takes it.

        ``effect_columns`` computes the columns that samples carry (:meth:`MeasurementModel.effect_columns`).

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
        self._gains = self._effort_gains()
        self._continuous = np.array([joint in continuous for joint in self._joints], dtype=bool)
        self._position = np.zeros(len(self._joints))
        self._names: list[str] = []
        self._order = np.zeros(len(self._joints), dtype=np.int64)
        self._effort_stamps = np.zeros(len(self._joints), dtype=np.int64)
        self._velocity = VelocityChoice(len(self._joints))
        self._grid: Grid | None = None
        self._streams: dict[str, Stream] = {}
        self._waiting: deque[tuple[str, int, FloatArray]] = deque()
        self._first_stamps: deque[int] = deque(maxlen=_MESSAGES_TO_INFER_PERIOD)
        self._last: dict[str, int] = {}
        self._late: Counter[str] = Counter()
        self._next_instant = 0
        self._pending: list[Samples] = []
        self.ledgers: dict[str, Ledger] = {}
        if settings.period > 0.0:
            self._start(round(settings.period * 1e9))

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

    def push_joints(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> None:
        """Take a joint message with any order of joints; ``stamp`` in ns. What cannot be used is counted."""
        self._push(JOINT_STATES, stamp, lambda: self._joint_vector(stamp, names, position, velocity, effort))

    def push_base_pose(self, stamp: int, pose: Sequence[float]) -> None:
        """Take the base's pose in the world, position [m] and quaternion xyzw."""
        self._push(ODOM, stamp, lambda: _pose_vector(pose))

    def push_wrench(self, topic: str, stamp: int, frame: str, wrench: Sequence[float]) -> None:
        """Take force [N] and torque [N m] of a sensor's topic, expressed in ``frame`` (as the message says)."""
        if topic not in self._sensors:
            raise unknown_name("wrench topic", topic, self._sensors)
        self._push(topic, stamp, lambda: _wrench_vector(self._sensors[topic], frame, wrench))

    def _push(self, topic: str, stamp: int, read: Callable[[], FloatArray]) -> None:
        try:
            self._check_stamp(topic, stamp)
            values = read()
        except _RejectedError as reason:
            ledger = self.ledgers.setdefault(topic, Ledger())
            ledger.received += 1
            ledger.rejected[str(reason)] += 1
            return
        self._last[topic] = stamp
        self._on_accepted(topic, stamp, values)
        self.push_accepted(topic, stamp, values)

    def push_accepted(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Take what another pipeline for the same robot has accepted, in the same order."""
        ledger = self.ledgers.setdefault(topic, Ledger())
        ledger.received += 1
        ledger.accepted += 1
        if self._grid is None:
            self._wait(topic, stamp, values)
        else:
            self._take(self._grid, topic, stamp, values)

    def _check_stamp(self, topic: str, stamp: int) -> None:
        """A few late messages are rejected; many in a row mean that the clock was set back, and all starts afresh."""
        if stamp <= 0:
            raise _RejectedError("stamp is zero" if stamp == 0 else "stamp is not valid")
        behind = self._last.get(topic, 0) - stamp
        self._late[topic] = self._late[topic] + 1 if behind > self._max_gap else 0
        if self._late[topic] == _LATE_MESSAGES_OF_A_RESET_CLOCK:
            self._forget()
        elif behind >= 0:
            raise _RejectedError("stamp not later than the one before")

    def _forget(self) -> None:
        self._last.clear()
        self._late.clear()
        self._waiting.clear()
        self._first_stamps.clear()
        self._effort_stamps[:] = 0
        self._next_instant = 0
        if self._grid is not None:
            self._open_streams(self._grid)

    def _wait(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Keep what arrives before the period is known."""
        self._waiting.append((topic, stamp, values))
        if len(self._waiting) > _MOST_WAITING:
            ledger = self.ledgers[self._waiting.popleft()[0]]
            ledger.accepted -= 1
            ledger.rejected["no joint states to go with"] += 1
        if topic == JOINT_STATES:
            self._first_stamps.append(stamp)
            if len(self._first_stamps) == _MESSAGES_TO_INFER_PERIOD:
                period = float(np.median(np.diff(self._first_stamps)))
                self._start(max(_PERIOD_ROUNDING, round(period / _PERIOD_ROUNDING) * _PERIOD_ROUNDING))

    def _take(self, grid: Grid, topic: str, stamp: int, values: FloatArray) -> None:
        """Pass values on and make what samples they complete at once, before a later gap restarts a stream."""
        self._streams[topic].push(stamp, values)
        if topic == JOINT_STATES and _EFFORTS in self._streams:
            self._streams[_EFFORTS].push(stamp - self._effort_delay, values[2 * len(self._joints) :])
        samples = self._ready_samples(grid)
        if samples is not None:
            self._pending.append(samples)
        self._drop_before((stamp - _HORIZON) // grid.period)

    def _joint_vector(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> FloatArray:
        order = self._order_of(names)
        for kind, values in (("position", position), ("velocity", velocity), ("effort", effort)):
            if len(values) not in ((len(names),) if kind == "position" else (0, len(names))):
                raise _RejectedError(f"{kind} has {len(values)} entries for {len(names)} names")
        vector = np.full((3, len(order)), np.nan)
        for row, values in enumerate((position, velocity, effort)):
            if len(values):
                vector[row] = np.asarray(values, dtype=np.float64)[order]
        if not np.all(_usable(vector[0])):
            raise _RejectedError("position not finite")
        vector[2] *= self._gains
        vector[1:][~_usable(vector[1:])] = np.nan
        self._check_effort(stamp, vector[2])
        if np.any(self._continuous):
            turns = np.where(self._continuous, np.round((self._position - vector[0]) / (2.0 * np.pi)), 0.0)
            vector[0] += 2.0 * np.pi * turns
            self._position = vector[0].copy()
        return vector.ravel()

    def _order_of(self, names: Sequence[str]) -> IntArray:
        """Where the robot's joints are among a message's names, most often as in the message before."""
        if not names:
            raise _RejectedError("no joint names")
        if self._names != list(names):
            index = {name: place for place, name in enumerate(names)}
            if len(index) != len(names):
                raise _RejectedError("a joint is named twice")
            missing = next((joint for joint in self._joints if joint not in index), None)
            if missing is not None:
                raise _RejectedError(f"joint '{missing}' is missing")
            self._names = list(names)
            self._order = np.array([index[joint] for joint in self._joints], dtype=np.int64)
        return self._order

    def _check_effort(self, stamp: int, effort: FloatArray) -> None:
        """An effort that fails for less than the longest gap costs the message, one that fails for longer its joint."""
        measured = np.isfinite(effort)
        lost = np.flatnonzero(~measured & (self._effort_stamps > 0) & (stamp - self._effort_stamps <= self._max_gap))
        if len(lost):
            raise _RejectedError(f"effort of '{self._joints[int(lost[0])]}' missing or not finite")
        self._effort_stamps[measured] = stamp

    def _start(self, period: int) -> None:
        grid = Grid(period, self._settings.cutoff, self._settings.samples_per_cutoff_period)
        self._grid = grid
        self._open_streams(grid)
        for topic, stamp, values in self._waiting:
            self._take(grid, topic, stamp, values)
        self._waiting.clear()

    def _open_streams(self, grid: Grid) -> None:
        self._joint_stream = JointStream(grid, self._max_gap, len(self._joints), self._effect_columns)
        self._streams = {JOINT_STATES: self._joint_stream}
        self._streams |= {topic: VectorStream(grid, self._max_gap) for topic in self._sensors}
        if self._effort_delay:
            self._streams[_EFFORTS] = VectorStream(grid, self._max_gap)
        if self._floating_base:
            self._streams[ODOM] = PoseStream(grid, self._max_gap)

    def collect(self) -> Samples | None:
        """The samples that have become ready since the last call, oldest first; None if there are none."""
        if not self._pending:
            return None
        samples = Samples.concatenate(self._pending)
        self._pending.clear()
        return samples

    def _ready_samples(self, grid: Grid) -> Samples | None:
        ranges = [stream.ready() for stream in self._streams.values()]
        start = max([self._next_instant, *(r.start for r in ranges)])
        instants = range(-(-start // grid.stride) * grid.stride, min(r.stop for r in ranges), grid.stride)
        if not instants:
            return None
        samples = self._samples(grid, instants)
        self._drop_before(instants[-1] + 1)
        return samples

    def _drop_before(self, instant: int) -> None:
        if instant > self._next_instant:
            self._next_instant = instant
            for stream in self._streams.values():
                stream.drop_before(instant)

    def _samples(self, grid: Grid, instants: range) -> Samples:
        count, joints = len(instants), len(self._joints)
        value, first, second = (
            part.reshape(count, 3, joints) for part in self._streams[JOINT_STATES].filtered(instants)
        )
        position = value[:, 0]
        position[:, self._continuous] = np.remainder(position[:, self._continuous] + np.pi, 2.0 * np.pi) - np.pi
        velocity, acceleration = self._velocity.choose(value[:, 1], first[:, 1], first[:, 0], second[:, 0])
        effort = self._streams[_EFFORTS].filtered(instants)[0] if self._effort_delay else value[:, 2]
        pose = base_velocity = base_acceleration = np.zeros((count, 0))
        if self._floating_base:
            pose, base_velocity, base_acceleration = self._streams[ODOM].filtered(instants)
        wrenches = np.zeros((count, len(self._sensors), 6))
        for index, topic in enumerate(self._sensors):
            wrenches[:, index] = self._streams[topic].filtered(instants)[0]
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
            self._joint_stream.effects(instants),
        )


def _usable(values: FloatArray) -> BoolArray:
    """False for NaN, infinity and numbers that no robot measures."""
    usable: BoolArray = np.abs(values) < _LARGEST_NUMBER
    return usable


def _pose_vector(pose: Sequence[float]) -> FloatArray:
    values = np.array(pose, dtype=np.float64)
    if not np.all(_usable(values)):
        raise _RejectedError("pose not finite")
    norm = float(np.linalg.norm(values[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise _RejectedError("quaternion is not of length 1")
    values[3:] /= norm
    return values


def _wrench_vector(sensor: WrenchSensor, frame: str, wrench: Sequence[float]) -> FloatArray:
    if frame and frame != sensor.frame:
        raise _RejectedError(f"frame '{frame}' is not the declared '{sensor.frame}'")
    values = np.array(wrench, dtype=np.float64)
    if not np.all(_usable(values[sensor.axis_indices])):
        raise _RejectedError("wrench not finite")
    return values - sensor.sign * np.array(sensor.offset)
