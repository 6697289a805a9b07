"""From accepted messages to samples: alignment, filtering, differentiation."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.samples import SAMPLES_PER_PIECE, Column, Entries, PlacedColumn, Samples
from geomid_ros.signals.clocks import FEWEST, FEWEST_IN_BURSTS, MotionClock, RegularClock, VelocityCheck, in_bursts
from geomid_ros.signals.joint_messages import FROZEN
from geomid_ros.signals.ledger import Account, Ledger, Reason, driver_error
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, AcceptedMessages
from geomid_ros.signals.moving_base import ImuSegment
from geomid_ros.signals.settings import MOST_WAITING, PERIOD_ROUNDING, SignalSettings
from geomid_ros.signals.streams import Grid, HeldSegment, JointSegment, PoseSegment, Stream, VectorSegment
from geomid_ros.types import BoolArray, FloatArray, IntArray

IN_BURSTS = driver_error(
    "messages come in bursts: stamps are times of arrival, not of measurement; times are computed from the order of "
    "messages; stamp them where they are measured"
)
NOW_IN_BURSTS = driver_error(
    "messages have begun to come in bursts: stamps are times of arrival, not of measurement; stamp them where they "
    "are measured"
)
LATE = Reason(
    "stamps are not the times of measurement: positions jerk between them, velocities do not; times are computed from "
    "velocities; stamp messages when they are measured",
    "told",
)
UNEVEN = driver_error("messages come in uneven bursts: their times of measurement are unknown")
_EFFORTS = "joint_states.effort"  # stream of delayed efforts; no topic has this name


class Sampler:
    """Takes accepted messages with :meth:`add`. :meth:`make_samples` computes the samples that they complete,
    :meth:`collect` returns them."""

    def __init__(
        self,
        model: MeasurementModel,
        settings: SignalSettings,
        effect_columns: tuple[Column, ...],
        ledger: Ledger,
        mount: ImuMount | None,
        controller: PDController | None,
    ) -> None:
        """
        Args:
            model: the robot and its sensors; positions of joints without limits are from -pi to pi in samples.
            settings: settings of the filter.
            effect_columns: columns of effects that samples contain.
            ledger: counts accepted messages that are dropped.
            mount: pose of the IMU on the base.
            controller: controller of the joints, if efforts are computed from commands.
        """
        self._settings = settings
        self._continuous = np.array([joint.continuous for joint in model.robot.joints], dtype=bool)
        self._wrenches = [sensor.topic for sensor in model.sensors]
        self._base = (ODOM if mount is None else IMU) if model.robot.floating_base else None
        self._mount, self._controller = mount, controller
        self._max_gap = settings.max_gap_ns
        self._effort_delay = round(1e9 * settings.effort_delay)
        self._entries = Entries(effect_columns, len(self._continuous))
        self._ledger = ledger
        self._velocities = VelocityCheck(len(self._continuous))
        self._clock: RegularClock | None = None  # of joint messages whose stamps are not times of measurement
        self._motion_clock: MotionClock  # once the period is known
        self._watched = np.zeros(0, dtype=np.int64)  # stamps of the last joint messages
        self._grid: Grid | None = None
        self._streams: dict[str, Stream[Any]] = {}
        self._waiting: deque[AcceptedMessages] = deque()
        self._next_instant = 0
        self._pending: list[Samples] = []
        if settings.period > 0.0:
            self._start(round(settings.period * 1e9))

    @property
    def period(self) -> float:
        """Period of the time grid [s]; 0 until the rate is known."""
        return self._grid.period * 1e-9 if self._grid is not None else 0.0

    @property
    def lag(self) -> float:
        """Time [s] by which samples trail the newest message; 0 until the rate is known."""
        return self._grid.lag * self.period if self._grid is not None else 0.0

    def add(self, accepted: AcceptedMessages) -> None:
        """Take messages that are later than the last ones of their topic. Raises InputError if the cutoff is too high
        for the rate."""
        if self._grid is None:
            self._wait(accepted)
        else:
            self._take(accepted)

    def restart(self) -> None:
        """Restart after a clock was set or positions leapt."""
        self.make_samples()
        self._waiting.clear()
        self._next_instant = 0
        if self._grid is not None:
            self._motion_clock.restart()
            self._open_streams(self._grid)

    def _wait(self, accepted: AcceptedMessages) -> None:
        """Keep messages that arrive before the period is known."""
        self._waiting.append(accepted)
        self._give_up(sum(map(len, self._waiting)) - MOST_WAITING, "no joint states to go with")
        while self._grid is None and self._begin():
            pass

    def _begin(self) -> bool:
        """Start if the joint messages determine the period. Return True if messages were dropped, as they do not."""
        parts = [accepted.stamps for accepted in self._waiting if accepted.topic == JOINT_STATES]
        stamps = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
        if len(stamps) < FEWEST:
            return False
        period = float(np.median(np.diff(stamps[:FEWEST])))
        if in_bursts(stamps[:FEWEST], self._max_gap):
            if len(stamps) < FEWEST_IN_BURSTS:
                return False
            clock = RegularClock(stamps[:FEWEST_IN_BURSTS])
            if not clock.is_right:
                self._give_up(FEWEST_IN_BURSTS, UNEVEN, JOINT_STATES)
                return True
            self._ledger.note(JOINT_STATES, IN_BURSTS)
            self._clock, period = clock, clock.period
        self._start(max(PERIOD_ROUNDING, round(period / PERIOD_ROUNDING) * PERIOD_ROUNDING))
        return False

    def _give_up(self, count: int, reason: str, topic: str = "") -> None:
        """Drop the first waiting messages, of all topics or of one."""
        skipped = list[AcceptedMessages]()
        while count > 0:
            oldest = self._waiting.popleft()
            dropped = min(count, len(oldest)) if topic in ("", oldest.topic) else 0
            if dropped:
                self._ledger.revoke(oldest.topic, reason, dropped)
                count -= dropped
            if dropped < len(oldest):
                skipped.append(oldest.after(dropped))
        self._waiting.extendleft(reversed(skipped))

    def _take(self, accepted: AcceptedMessages) -> None:
        stamps, values = accepted.stamps, accepted.values
        if self._clock is not None and accepted.topic == JOINT_STATES:
            stamps = self._clock.times(stamps)
        elif accepted.topic == JOINT_STATES:
            self._watch(stamps)
            stamps = self._times(stamps, values)
        if accepted.topic == COMMANDS and self._controller is not None:
            stamps = stamps + self._controller.delay
        self._streams[accepted.topic].push(stamps, values)
        if accepted.topic == JOINT_STATES and self._effort_delay:
            self._streams[_EFFORTS].push(stamps - self._effort_delay, values[:, 2 * len(self._continuous) :])

    def _times(self, stamps: IntArray, values: FloatArray) -> IntArray:
        """Return the times of measurement of joint messages; note in the ledger if the stamps are others."""
        was_used, joints = self._motion_clock.is_used, len(self._continuous)
        times = self._motion_clock.times(stamps, values[:, :joints], values[:, joints : 2 * joints])
        if self._motion_clock.is_used and not was_used:
            self._ledger.note(JOINT_STATES, LATE)
        return times

    def _watch(self, stamps: IntArray) -> None:
        """Note in the ledger if messages begin to come in bursts."""
        self._watched = np.concatenate([self._watched, stamps])
        while len(self._watched) >= FEWEST_IN_BURSTS:
            if in_bursts(self._watched[:FEWEST_IN_BURSTS], self._max_gap):
                self._ledger.note(JOINT_STATES, NOW_IN_BURSTS)
            self._watched = self._watched[FEWEST_IN_BURSTS:]

    def _start(self, period: int) -> None:
        try:
            grid = Grid(period, self._settings.cutoff)
        except InputError as error:
            raise InputError(f"{error}{self._repeated()}") from error
        self._grid = grid
        self._motion_clock = MotionClock(len(self._continuous), float(period))
        self._open_streams(grid)
        for accepted in self._waiting:
            self._take(accepted)
        self._waiting.clear()

    def _repeated(self) -> str:
        """Sentence on joint messages that only repeat the one before, which lowers the rate; empty if none do."""
        rejected = self._ledger.topics.get(JOINT_STATES, Account()).rejected
        if not (repeated := rejected[FROZEN]):
            return ""
        # Accepted ones all wait for the period, and are in the ledger only after they have been taken.
        count = rejected.total() + sum(len(each) for each in self._waiting if each.topic == JOINT_STATES)
        return (
            f". Of the first {count} messages on {JOINT_STATES} {repeated} only repeat the one before "
            "though the robot moves, and are left out: the driver publishes more often than it measures"
        )

    def _open_streams(self, grid: Grid) -> None:
        segments: dict[str, Callable[[], Any]] = {JOINT_STATES: partial(JointSegment, grid, self._entries)}
        segments |= dict.fromkeys(self._wrenches, partial(VectorSegment, grid))
        if self._effort_delay:
            segments[_EFFORTS] = partial(VectorSegment, grid)
        if self._controller is not None:
            segments[COMMANDS] = partial(HeldSegment, grid)
        if self._mount is not None:
            segments[IMU] = partial(ImuSegment, grid, self._mount)
        elif self._base is not None:
            segments[ODOM] = partial(PoseSegment, grid)
        self._streams = {topic: Stream(self._max_gap, segment) for topic, segment in segments.items()}

    def collect(self) -> Samples | None:
        """Return the samples that became ready since the last call, oldest first; None if there are none."""
        if not self._pending:
            return None
        samples = Samples.concatenate(self._pending)
        self._pending.clear()
        return samples

    def make_samples(self) -> None:
        """Compute the samples for which every topic has data, also after pauses; discard data that are too old."""
        grid, streams = self._grid, self._streams.values()
        if grid is None:
            return
        while True:
            ranges = [stream.segment.ready() for stream in streams]
            start = max([self._next_instant, *(r.start for r in ranges)])
            instants = range(-(-start // grid.stride) * grid.stride, min(r.stop for r in ranges), grid.stride)[
                :SAMPLES_PER_PIECE
            ]
            if instants:
                samples = self._samples(grid, instants)
                self._pending += [samples] if len(samples) else []
                self._next_instant = instants[-1] + 1
                for stream in streams:
                    stream.drop_before(self._next_instant)
            elif not any(stream.skip_to(instants.start) for stream in streams):
                break
        for stream in streams:
            stream.forget(grid)

    def _samples(self, grid: Grid, instants: range) -> Samples:
        count, segments = len(instants), {topic: stream.segment for topic, stream in self._streams.items()}
        motion = segments[JOINT_STATES]
        value, first, second = (part.reshape(count, 3, -1) for part in motion.filtered(instants))
        position, velocity, acceleration = value[:, 0], first[:, 0], second[:, 0]
        if self._continuous.any():
            position[:, self._continuous] = np.remainder(position[:, self._continuous] + np.pi, 2.0 * np.pi) - np.pi
        sums = self._velocities.add(value[:, 1], velocity)
        if remark := self._velocities.remark():
            self._ledger.note(JOINT_STATES, remark)
        effort = segments[_EFFORTS].filtered(instants)[0] if self._effort_delay else value[:, 2]
        effects, commands = motion.effects(instants), np.zeros((count, 4, 0))
        if self._controller is not None:
            ref, rates, _ = (part.reshape(count, 3, -1) for part in segments[COMMANDS].filtered(instants))
            commands = np.concatenate([ref, effort[:, None]], axis=1)
            # The controller acts on these set-points, and on the velocity that its driver sends.
            sent = np.where(self._velocities.are_derivatives(value[:, 1], sums), value[:, 1], velocity)
            effort = self._controller.efforts(ref, value[:, 0], sent)
            for column in self._entries.columns:
                if isinstance(column, PlacedColumn) and column.effect.place == "commands":
                    effects[:, self._entries.of(column)[0]] = self._controller.rate(rates)
        pose = base_velocity = base_acceleration = np.zeros((count, 0))
        if self._base is not None:
            pose, base_velocity, base_acceleration = segments[self._base].filtered(instants)
        wrenches = np.zeros((count, len(self._wrenches), 6))
        for index, topic in enumerate(self._wrenches):
            wrenches[:, index] = segments[topic].filtered(instants)[0]
        samples = Samples(
            stamps=np.array(instants) * grid.period,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            effort=effort,
            base_pose=pose,
            base_velocity=base_velocity,
            base_acceleration=base_acceleration,
            wrenches=wrenches,
            effects=effects,
            entries=self._entries,
            commands=commands,
            acceleration_noise=motion.noise(instants, position.shape[1]),
        )
        return samples if self._mount is None else samples.select(self._with_gravity(instants))

    def _with_gravity(self, instants: range) -> BoolArray:
        """True for ``instants`` at which the IMU's mean specific force is gravity; faults are noted in the ledger."""
        faults = self._streams[IMU].segment.faults(instants)
        for fault in dict.fromkeys(filter(None, faults)):
            self._ledger.note(IMU, fault)
        return np.array([not fault for fault in faults], dtype=np.bool_)
