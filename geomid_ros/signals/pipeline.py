"""From messages' numbers to samples: mapping, checks, alignment, filtering, differentiation.

The node and the bag reader feed one message after the other and collect what samples have become ready; both get the
same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.streams import Grid, PoseStream, Stream, VectorStream
from geomid_ros.types import FloatArray

_PERIOD_ROUNDING = 10_000  # [ns] an inferred period is rounded to this
_MESSAGES_TO_INFER_PERIOD = 32


@dataclass(frozen=True)
class SignalSettings:
    """How signals are filtered, and what an effort number means.

    ``cutoff`` [Hz] of the low-pass; ``period`` [s] of the time grid, inferred from the first joint messages when 0;
    ``max_gap`` [s] a longer pause of a topic starts a new segment; ``effort_gain`` multiplies the messages' efforts to
    make N m (or N), one number for all joints or one by joint name (negative reverses the sign).
    """

    cutoff: float = 5.0
    period: float = 0.0
    max_gap: float = 0.5
    effort_gain: float | dict[str, float] = 1.0
    samples_per_cutoff_period: float = 8.0


@dataclass
class Ledger:
    """What became of the messages of a topic: ``received = accepted + sum(rejected)``."""

    received: int = 0
    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)


class _Rejected(Exception):
    """A message that cannot be used; its text is the reason that is counted."""


class SignalPipeline:
    """Feeds: :meth:`push_joints`, :meth:`push_base_pose`, :meth:`push_wrench`; result: :meth:`collect`."""

    def __init__(
        self,
        joints: Sequence[str],
        *,
        floating_base: bool = False,
        sensors: Sequence[WrenchSensor] = (),
        settings: SignalSettings = SignalSettings(),
    ) -> None:
        self._joints = tuple(joints)
        self._sensors = tuple(sensors)
        self._floating_base = floating_base
        self._settings = settings
        self._gains = self._effort_gains()
        self._effort_seen = np.zeros(len(self._joints), dtype=bool)
        self._velocity = _VelocityChoice(len(self._joints))
        self._grid: Grid | None = None
        self._streams: dict[str, Stream] = {}
        self._waiting: list[tuple[str, int, FloatArray]] = []
        self._last: dict[str, int] = {}
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
                raise InputError(f"effort gain for '{name}', which is not a joint. Joints: {', '.join(self._joints)}")
        return np.array([gain.get(name, 1.0) for name in self._joints])

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._grid.half * self._grid.period * 1e-9 if self._grid is not None else 0.0

    def push_joints(
        self,
        stamp: int,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> None:
        """Take a joint message with any order of joints; ``stamp`` in ns. What cannot be used is counted."""
        self._push("joint_states", stamp, lambda: self._joint_vector(names, position, velocity, effort))

    def push_base_pose(self, stamp: int, pose: Sequence[float]) -> None:
        """Take the base's pose in the world, position [m] and quaternion xyzw."""
        self._push("odom", stamp, lambda: _pose_vector(pose))

    def push_wrench(self, topic: str, stamp: int, frame: str, wrench: Sequence[float]) -> None:
        """Take force [N] and torque [N m] of a sensor's topic, expressed in ``frame`` (as the message says)."""
        sensor = next(sensor for sensor in self._sensors if sensor.topic == topic)
        self._push(topic, stamp, lambda: _wrench_vector(sensor, frame, wrench))

    def _push(self, topic: str, stamp: int, read: Callable[[], FloatArray]) -> None:
        ledger = self.ledgers.setdefault(topic, Ledger())
        ledger.received += 1
        try:
            if stamp <= 0:
                raise _Rejected("stamp is zero")
            if stamp <= self._last.get(topic, 0):
                raise _Rejected("stamp not later than the one before")
            values = read()
        except _Rejected as reason:
            ledger.rejected[str(reason)] += 1
            return
        ledger.accepted += 1
        self._last[topic] = stamp
        if self._grid is None:
            self._waiting.append((topic, stamp, values))
            self._infer_period()
        else:
            self._take(topic, stamp, values)

    def _take(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Pass values on and make what samples they complete at once, before a later gap restarts a stream."""
        self._streams[topic].push(stamp, values)
        if self._grid is not None:
            samples = self._ready_samples(self._grid)
            if samples is not None:
                self._pending.append(samples)

    def _joint_vector(
        self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float], effort: Sequence[float]
    ) -> FloatArray:
        if not names:
            raise _Rejected("no joint names")
        index = {name: place for place, name in enumerate(names)}
        if len(index) != len(names):
            raise _Rejected("a joint is named twice")
        missing = next((joint for joint in self._joints if joint not in index), None)
        if missing is not None:
            raise _Rejected(f"joint '{missing}' is missing")
        for kind, values in (("position", position), ("velocity", velocity), ("effort", effort)):
            if len(values) not in ((len(names),) if kind == "position" else (0, len(names))):
                raise _Rejected(f"{kind} has {len(values)} entries for {len(names)} names")
        order = [index[joint] for joint in self._joints]
        vector = np.full((3, len(order)), np.nan)
        for row, values in enumerate((position, velocity, effort)):
            if len(values):
                vector[row] = np.asarray(values, dtype=np.float64)[order]
        if not np.all(np.isfinite(vector[0])):
            raise _Rejected("position not finite")
        vector[2] *= self._gains
        finite = np.isfinite(vector[2])
        lost = np.flatnonzero(self._effort_seen & ~finite)
        if len(lost):
            raise _Rejected(f"effort of '{self._joints[int(lost[0])]}' not finite")
        self._effort_seen |= finite
        vector[1:][~np.isfinite(vector[1:])] = np.nan
        return vector.ravel()

    def _infer_period(self) -> None:
        stamps = [stamp for topic, stamp, _ in self._waiting if topic == "joint_states"]
        if len(stamps) >= _MESSAGES_TO_INFER_PERIOD:
            period = float(np.median(np.diff(stamps)))
            self._start(max(_PERIOD_ROUNDING, round(period / _PERIOD_ROUNDING) * _PERIOD_ROUNDING))

    def _start(self, period: int) -> None:
        grid = Grid(period, self._settings.cutoff, self._settings.samples_per_cutoff_period)
        max_gap = round(self._settings.max_gap * 1e9)
        self._grid = grid
        self._streams["joint_states"] = VectorStream(grid, max_gap)
        if self._floating_base:
            self._streams["odom"] = PoseStream(grid, max_gap)
        for sensor in self._sensors:
            self._streams[sensor.topic] = VectorStream(grid, max_gap)
        for topic, stamp, values in self._waiting:
            self._take(topic, stamp, values)
        self._waiting.clear()

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
        self._next_instant = instants[-1] + 1
        for stream in self._streams.values():
            stream.drop_before(self._next_instant)
        return samples

    def _samples(self, grid: Grid, instants: range) -> Samples:
        count, joints = len(instants), len(self._joints)
        value, first, second = (
            part.reshape(count, 3, joints) for part in self._streams["joint_states"].filtered(instants)
        )
        velocity, acceleration = self._velocity.choose(value[:, 1], first[:, 1], first[:, 0], second[:, 0])
        pose = base_velocity = base_acceleration = np.zeros((count, 0))
        if self._floating_base:
            pose, base_velocity, base_acceleration = self._streams["odom"].filtered(instants)
        wrenches = np.zeros((count, len(self._sensors), 6))
        for index, sensor in enumerate(self._sensors):
            wrenches[:, index] = self._streams[sensor.topic].filtered(instants)[0]
        stamps = np.array([instant * grid.period for instant in instants], dtype=np.int64)
        return Samples(
            stamps,
            value[:, 0],
            velocity,
            acceleration,
            value[:, 2],
            pose,
            base_velocity,
            base_acceleration,
            wrenches,
        )


class _VelocityChoice:
    """Per joint: the message's velocity while it agrees with the position's derivative, else that derivative.

    They agree while the mean squared difference over the recent past is below 5 % of the derivative's mean square, both
    with a memory of about 100 samples, and not before that many were seen.
    """

    _MEMORY = 100
    _RELATIVE_DISAGREEMENT = 0.05

    def __init__(self, joints: int) -> None:
        self._seen = np.zeros(joints)
        self._difference = np.zeros(joints)
        self._energy = np.zeros(joints)

    def choose(
        self, given: FloatArray, given_rate: FloatArray, derived: FloatArray, derived_rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Velocities and accelerations ``(N, joints)`` from the filtered message velocity and its derivative, and from
        the filtered position's first and second derivative."""
        velocity, acceleration = derived.copy(), derived_rate.copy()
        for row in range(len(derived)):
            usable = np.isfinite(given[row])
            error = np.where(usable, given[row] - derived[row], 0.0)
            self._seen = np.where(usable, self._seen + 1, 0.0)
            share = 1.0 / np.minimum(np.maximum(self._seen, 1.0), self._MEMORY)
            self._difference += share * (error**2 - self._difference)
            self._energy += share * (derived[row] ** 2 - self._energy)
            agrees = self._difference <= self._RELATIVE_DISAGREEMENT**2 * self._energy
            use = usable & agrees & (self._seen >= self._MEMORY)
            velocity[row, use] = given[row, use]
            acceleration[row, use] = given_rate[row, use]
        return velocity, acceleration


def _pose_vector(pose: Sequence[float]) -> FloatArray:
    values = np.asarray(pose, dtype=np.float64)
    if not np.all(np.isfinite(values)):
        raise _Rejected("pose not finite")
    norm = float(np.linalg.norm(values[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise _Rejected("quaternion is not of length 1")
    values[3:] /= norm
    return values


def _wrench_vector(sensor: WrenchSensor, frame: str, wrench: Sequence[float]) -> FloatArray:
    if frame and frame != sensor.frame:
        raise _Rejected(f"frame '{frame}' is not the declared '{sensor.frame}'")
    values = np.asarray(wrench, dtype=np.float64)
    if not np.all(np.isfinite(values[sensor.axis_indices])):
        raise _Rejected("wrench not finite")
    return values
