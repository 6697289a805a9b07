"""From accepted numbers to samples: alignment, filtering, differentiation."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.columns import Column, Entries, PlacedColumn
from geomid_ros.model.controller import Controller
from geomid_ros.model.imu import ImuMount
from geomid_ros.model.samples import PIECE, Samples
from geomid_ros.signals.clocks import FEWEST, FEWEST_IN_BURSTS, RegularClock, VelocityCheck, in_bursts
from geomid_ros.signals.joint_messages import FROZEN
from geomid_ros.signals.ledger import Account, Ledger, driver_error
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, Accepted
from geomid_ros.signals.moving_base import ImuSegment
from geomid_ros.signals.settings import HORIZON, MOST_WAITING, PERIOD_ROUNDING, SignalSettings
from geomid_ros.signals.streams import Grid, HeldSegment, JointSegment, PoseSegment, Stream, VectorSegment
from geomid_ros.types import BoolArray, IntArray

IN_BURSTS = driver_error(
    "messages come in bursts: their stamps do not say when they were measured, their numbers in the row "
    "do; stamp them where they are measured"
)
NOW_IN_BURSTS = driver_error(
    "messages have begun to come in bursts: their stamps do not say when they were measured; stamp them "
    "where they are measured"
)
UNEVEN = driver_error("messages come in uneven bursts: nothing says when they were measured")
_EFFORTS = "joint_states.effort"  # stream of efforts with a delay; no topic has that name


class Sampler:
    """Takes accepted numbers with :meth:`add`; :meth:`make_samples` makes the samples that they complete, and
    :meth:`collect` gives them."""

    def __init__(
        self,
        settings: SignalSettings,
        continuous: BoolArray,
        topics: Sequence[str],
        effect_columns: tuple[Column, ...],
        ledger: Ledger,
        mount: ImuMount | None = None,
        controller: Controller | None = None,
    ) -> None:
        """
        Args:
            settings: of the filter.
            continuous: ``(joints,)`` which joints have no end; their positions are from -pi to pi in samples.
            topics: of the numbers beside joints': those of the wrench sensors, and ODOM or IMU of a floating base.
            effect_columns: those of effects that samples carry.
            ledger: is told of accepted messages that are given up.
            mount: of the IMU.
            controller: of the joints, if efforts are those of commands.
        """
        self._settings = settings
        self._continuous = continuous
        self._wrenches = [topic for topic in topics if topic not in (ODOM, IMU)]
        self._base = next((topic for topic in topics if topic in (ODOM, IMU)), None)
        self._mount, self._controller = mount, controller
        self._max_gap = settings.max_gap_ns
        self._effort_delay = settings.effort_delay_ns
        self._entries = Entries(effect_columns, len(continuous))
        self._ledger = ledger
        self._velocities = VelocityCheck(len(continuous))
        self._clock: RegularClock | None = None  # of joint messages whose stamps do not say when they were measured
        self._watched = np.zeros(0, dtype=np.int64)  # stamps of the last joint messages
        self._grid: Grid | None = None
        self._streams: dict[str, Stream[Any]] = {}
        self._waiting: deque[Accepted] = deque()
        self._newest: dict[str, int] = {}  # stamp of each topic
        self._next_instant = 0
        self._pending: list[Samples] = []
        if settings.period > 0.0:
            self._start(round(settings.period * 1e9))

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._grid.lag * self._grid.period * 1e-9 if self._grid is not None else 0.0

    def add(self, accepted: Accepted) -> None:
        """Take numbers, later than the last ones of their topic. Raises InputError if the cutoff is too high for the
        rate."""
        if self._grid is None:
            self._wait(accepted)
        else:
            self._take(accepted)

    def restart(self) -> None:
        """Begin anew, as a clock was set back."""
        self.make_samples()
        self._waiting.clear()
        self._newest.clear()
        self._next_instant = 0
        if self._grid is not None:
            self._open_streams(self._grid)

    def _wait(self, accepted: Accepted) -> None:
        """Keep what arrives before the period is known."""
        self._waiting.append(accepted)
        self._give_up(sum(map(len, self._waiting)) - MOST_WAITING, "no joint states to go with")
        while self._grid is None and self._begin():
            pass

    def _begin(self) -> bool:
        """Start if the joint messages so far tell the period. Returns whether messages were given up, as they tell
        nothing."""
        parts = [each.stamps for each in self._waiting if each.topic == JOINT_STATES]
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
        """Give up the first messages that wait, of all topics or of one."""
        passed = list[Accepted]()
        while count > 0:
            oldest = self._waiting.popleft()
            given_up = min(count, len(oldest)) if topic in ("", oldest.topic) else 0
            if given_up:
                self._ledger.revoke(oldest.topic, reason, given_up)
                count -= given_up
            if given_up < len(oldest):
                passed.append(oldest.after(given_up))
        self._waiting.extendleft(reversed(passed))

    def _take(self, accepted: Accepted) -> None:
        stamps, values = accepted.stamps, accepted.values
        if self._clock is not None and accepted.topic == JOINT_STATES:
            stamps = self._clock.times(stamps)
        elif accepted.topic == JOINT_STATES:
            self._watch(stamps)
        if accepted.topic == COMMANDS and self._controller is not None:
            stamps = stamps + self._controller.delay
        self._streams[accepted.topic].push(stamps, values)
        self._newest[accepted.topic] = int(stamps[-1])
        if accepted.topic == JOINT_STATES and self._effort_delay:
            self._streams[_EFFORTS].push(stamps - self._effort_delay, values[:, 2 * len(self._continuous) :])
            self._newest[_EFFORTS] = int(stamps[-1])

    def _watch(self, stamps: IntArray) -> None:
        """Say it if messages begin to come in bursts."""
        self._watched = np.concatenate([self._watched, stamps])
        while len(self._watched) >= FEWEST_IN_BURSTS:
            if in_bursts(self._watched[:FEWEST_IN_BURSTS], self._max_gap):
                self._ledger.note(JOINT_STATES, NOW_IN_BURSTS)
            self._watched = self._watched[FEWEST_IN_BURSTS:]

    def _start(self, period: int) -> None:
        try:
            grid = Grid(period, self._settings.cutoff, self._settings.samples_per_cutoff_period)
        except InputError as error:
            raise InputError(f"{error}{self._repeated()}") from error
        self._grid = grid
        self._open_streams(grid)
        for accepted in self._waiting:
            self._take(accepted)
        self._waiting.clear()

    def _repeated(self) -> str:
        """What to say of joint messages that are slower than their rate, as some only repeat the one before."""
        account = self._ledger.topics.get(JOINT_STATES, Account())
        if not (repeated := account.rejected[FROZEN]):
            return ""
        return (
            f". Of the first {account.received} messages on {JOINT_STATES} {repeated} only repeat the one before "
            "though the robot moves, and are left out: the driver publishes more often than it measures"
        )

    def _open_streams(self, grid: Grid) -> None:
        self._joint_stream = Stream(self._max_gap, partial(JointSegment, grid, self._entries))
        segments: dict[str, Callable[[], Any]] = dict.fromkeys(self._wrenches, partial(VectorSegment, grid))
        if self._effort_delay:
            segments[_EFFORTS] = partial(VectorSegment, grid)
        if self._controller is not None:
            segments[COMMANDS] = partial(HeldSegment, grid)
        if self._mount is not None:
            segments[IMU] = partial(ImuSegment, grid, self._mount)
        elif self._base is not None:
            segments[ODOM] = partial(PoseSegment, grid)
        streams = {topic: Stream(self._max_gap, segment) for topic, segment in segments.items()}
        self._streams = {JOINT_STATES: self._joint_stream, **streams}

    def collect(self) -> Samples | None:
        """The samples that have become ready since the last call, oldest first; None if there are none."""
        if not self._pending:
            return None
        samples = Samples.concatenate(self._pending)
        self._pending.clear()
        return samples

    def make_samples(self) -> None:
        """Make the samples for which every topic has numbers, going on after pauses; forget what is too old."""
        grid, streams = self._grid, self._streams.values()
        while grid is not None:
            ranges = [stream.segment.ready() for stream in streams]
            start = max([self._next_instant, *(r.start for r in ranges)])
            instants = range(-(-start // grid.stride) * grid.stride, min(r.stop for r in ranges), grid.stride)[:PIECE]
            if instants:
                samples = self._samples(grid, instants)
                self._pending += [samples] if len(samples) else []
                self._next_instant = instants[-1] + 1
                for stream in streams:
                    stream.drop_before(self._next_instant)
            elif not any(stream.skip_to(instants.start) for stream in streams):
                break
        for name, newest in self._newest.items():
            if grid is not None:
                oldest = (newest - HORIZON) // grid.period - grid.lag
                self._streams[name].forget(oldest)

    def _samples(self, grid: Grid, instants: range) -> Samples:
        count, joints = len(instants), len(self._continuous)
        parts = self._joint_stream.segment.filtered(instants)
        value, first, second = (part.reshape(count, 3, joints) for part in parts)
        position, velocity, acceleration = value[:, 0], first[:, 0], second[:, 0]
        if self._continuous.any():
            position[:, self._continuous] = np.remainder(position[:, self._continuous] + np.pi, 2.0 * np.pi) - np.pi
        told = self._velocities.add(value[:, 1], velocity)
        if remark := self._velocities.remark():
            self._ledger.note(JOINT_STATES, remark)
        effort = self._streams[_EFFORTS].segment.filtered(instants)[0] if self._effort_delay else value[:, 2]
        effects, commands = self._joint_stream.segment.effects(instants), np.zeros((count, 4, 0))
        if self._controller is not None:
            own, rates, _ = (part.reshape(count, 3, -1) for part in self._streams[COMMANDS].segment.filtered(instants))
            commands = np.concatenate([own, effort[:, None]], axis=1)
            # A controller acts on the velocity that its driver sends.
            sent = np.where(self._velocities.are_derivatives(value[:, 1], told), value[:, 1], velocity)
            effort = self._controller.efforts(own, value[:, 0], sent)
            for column in self._entries.columns:
                if isinstance(column, PlacedColumn) and column.effect.place == "commands":
                    effects[:, self._entries.of(column)[0]] = self._controller.rate(rates)
        pose = base_velocity = base_acceleration = np.zeros((count, 0))
        if self._base is not None:
            pose, base_velocity, base_acceleration = self._streams[self._base].segment.filtered(instants)
        wrenches = np.zeros((count, len(self._wrenches), 6))
        for index, topic in enumerate(self._wrenches):
            wrenches[:, index] = self._streams[topic].segment.filtered(instants)[0]
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
        )
        return samples if self._mount is None else samples.select(self._with_gravity(instants))

    def _with_gravity(self, instants: range) -> BoolArray:
        """Those of ``instants`` at which the IMU's specific force is gravity on average; what else it is is noted."""
        faults = self._streams[IMU].segment.faults(instants)
        for fault in dict.fromkeys(filter(None, faults)):
            self._ledger.note(IMU, fault)
        return np.array([not fault for fault in faults], dtype=np.bool_)
