"""The one object that the node and the command line drive: samples in, estimates out."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import usable
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart, estimate
from geomid_ros.estimation.fit import INDEPENDENT
from geomid_ros.estimation.revocable_buffer import Instant, RevocableBuffer
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.model.samples import PIECE, REGIMES, Samples, regimes
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.types import BoolArray, FloatArray, IntArray

NOT_MEASURED = "not measured"
STANDING_STILL = "standing still"
LONGEST_STEP = 1.0
"""[s] between rows; a longer pause counts as so long."""


@dataclass(frozen=True)
class BufferSettings:
    """Which rows are taken, and how long they count. Raises InputError for values that cannot be.

    Attributes:
        still_speed, still_distance: An instant at which nothing moves faster [rad/s or m/s], and that lies nearer to
            the last one taken [rad or m], carries no new information and is not taken.
        forgetting_time: Time constant [s] with which the weight of earlier rows falls while rows are taken; infinite
            to forget nothing.
        folds, block: See :class:`RowSummary`.
    """

    still_speed: float = 1e-3
    still_distance: float = 1e-2
    forgetting_time: float = np.inf
    folds: int = 16
    block: int = 8

    def __post_init__(self) -> None:
        if not self.forgetting_time > 0.0:
            raise InputError(f"forgetting time is {self.forgetting_time:g} s, expected a number greater than zero")
        if self.folds < 2 or self.folds % 2 or self.block < 1:
            raise InputError(f"{self.folds} folds of {self.block} instants, expected an even number of one or more")


@dataclass(frozen=True, eq=False)
class Memory:
    """The state of an :class:`Identifier`: rows, why others were not taken, the last pose and its stamp [ns]."""

    summary: SummaryState
    rows_rejected: Counter[str]
    last_pose: FloatArray | None
    last_stamp: int | None


@dataclass(frozen=True, eq=False)
class RowCounts:
    """Numbers of rows since the last reset: ``made = taken + sum(rejected by reason)``."""

    made: int
    taken: int
    rejected: Counter[str]


@dataclass(frozen=True, eq=False)
class EstimationTask:
    """An estimation problem except for its rows: the arguments of :func:`estimate`."""

    model: MeasurementModel
    settings: EstimatorSettings
    prior: FloatArray | None

    def solve(self, summary: RowSummary, warm: WarmStart | None) -> Estimate:
        """The estimate from these rows; without ``warm`` it depends on nothing else."""
        return estimate(self.model, summary, self.settings, self.prior, warm)


Solve: TypeAlias = Callable[[EstimationTask, RowSummary, WarmStart | None], Estimate]


class Identifier:
    """Accumulates samples' rows and solves for the parameters. One thread may add while another solves.

    Instants with new rows are counted (:attr:`instants`). Rows of some channels can be left out from an instant on, as
    if they had never been taken, as far back as instants are held (:meth:`hold`) and not yet settled. Estimates are of
    all rows that are not left out.
    """

    def __init__(
        self,
        model: MeasurementModel,
        estimator: EstimatorSettings | None = None,
        buffer: BufferSettings | None = None,
        prior: FloatArray | None = None,
    ) -> None:
        """``prior (D,)``: start from these parameters instead of the URDF's (see :func:`estimate`).

        Raises InputError for a weighed mass that does not fit the model.
        """
        self.model = model
        self._task = EstimationTask(model, estimator or EstimatorSettings(), prior)
        self._solve: Solve = EstimationTask.solve
        self._buffer = buffer or BufferSettings()
        weighed_rows(model, self._task.settings.known)
        self._lock = threading.Lock()
        self._held = 0
        self.instants = 0
        """How many instants had new rows so far: the number of the next one."""
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._summary = self._empty_summary()
        self._recent = RevocableBuffer()
        self._made = 0
        self._rejected: Counter[str] = Counter()
        self._last_pose: FloatArray | None = None
        self._last_stamp: int | None = None

    def _empty_summary(self) -> RowSummary:
        buffer = self._buffer
        apart = 1.0 / (INDEPENDENT * self._task.settings.cutoff)
        return RowSummary(self.model.channels, buffer.folds, buffer.block, buffer.forgetting_time, apart)

    def reset(self) -> None:
        """Forget all samples, and what is left out. Instants are counted on."""
        with self._lock:
            self._begin_anew()

    def add(
        self, samples: Samples, without: slice = slice(0), carried: FloatArray | None = None
    ) -> tuple[IntArray, Rows, BoolArray]:
        """Take samples, in the order of time.

        Args:
            samples: what was measured.
            without: parameters of a body that the robot did not carry then.
            carried: parameters ``(D,)`` of what it carried beside; what that adds to the targets is taken off those
                that are learned from, not those that are returned.

        Returns:
            Stamps ``(N,)`` and rows of those samples that are not standing still, and which of their channels
            ``(N, channels)`` are unsettled: efforts of joints at rest or near a reversal, whose dry friction may be
            anything.
        """
        rows = self.model.rows(samples)
        rows.coefficients[:, :, without] = 0.0
        moving = np.zeros(len(samples), dtype=bool)
        elapsed = np.zeros(len(samples))
        of_motion = self._regimes(samples)
        measured = usable(rows.coefficients, rows.targets)
        counts, targets = np.count_nonzero(measured, axis=1), np.where(measured, rows.targets, np.nan)
        targets -= 0.0 if carried is None else rows.coefficients @ carried
        speeds = np.max(np.abs(np.concatenate([samples.velocity, samples.base_velocity], axis=1)), axis=1)
        poses = np.concatenate([samples.position, samples.base_pose], axis=1)
        with self._lock:
            self._made += measured.size
            self._rejected[NOT_MEASURED] += measured.size - int(np.sum(counts))
            for index in range(len(samples)):
                elapsed[index] = self._elapsed(int(samples.stamps[index]))
                if self._is_still(float(speeds[index]), poses[index]):
                    self._rejected[STANDING_STILL] += int(counts[index])
                else:
                    moving[index] = True
            own = slice(None) if moving.all() else moving  # a slice copies nothing
            taken, of_motion = Rows(rows.coefficients[own], rows.targets[own]), of_motion[own]
            self._take(taken.coefficients, targets[own], elapsed[own], of_motion, samples.states[own])
        return samples.stamps[own], taken, of_motion == REGIMES - 1

    def _take(
        self,
        coefficients: FloatArray,
        targets: FloatArray,
        elapsed: FloatArray,
        of_motion: IntArray,
        states: FloatArray,
    ) -> None:
        """Take the rows of instants at which something moved."""
        if self._held == 0 and self._recent.idle:  # otherwise they would only pass through
            self._summary.add(coefficients, targets, elapsed, of_motion, states)
            self.instants += len(elapsed)
            return
        for instant in zip(coefficients, targets, elapsed.tolist(), of_motion, states, strict=True):
            self._recent.append(Instant(self.instants, *instant))
            self.instants += 1
        self._settle_before(self.instants - self._held)

    def _regimes(self, samples: Samples) -> IntArray:
        """The regime of motion of each channel at N instants ``(N, channels)``: of efforts, those of their joints."""
        found = np.zeros((len(samples), len(self.model.channels)), dtype=np.int64)
        if self.model.layout.efforts:
            found[:, self.model.layout.efforts] = regimes(samples)
        return found

    def _settle_before(self, number: float) -> None:
        settled = list[Instant]()
        while self._recent.first < number:
            instant, rejected = self._recent.pop()
            self._rejected += rejected
            settled.append(instant)
        _with(self._summary, settled)

    def hold(self, instants: int) -> None:
        """Hold so many last instants (none at first), whose rows can still be left out; settle earlier ones."""
        with self._lock:
            self._held = instants
            self._settle_before(self.instants - instants)

    def settle(self, before: int) -> None:
        """Keep the rows of instants ``before`` this number for good; a thread that adds meanwhile hardly waits."""
        while True:
            with self._lock:
                if self._recent.first >= before:
                    break
                self._settle_before(min(before, self._recent.first + PIECE))

    def leave_out(self, reason: str, channels: Sequence[int], begin: int) -> bool:
        """Leave out the rows of ``channels`` from the instant of number ``begin`` on, as far as they are not settled.

        They count as rejected for this ``reason``. False if they were left out before.
        """
        with self._lock:
            return self._recent.leave_out(reason, channels, begin)

    def take_again(self, reason: str, begin: int) -> bool:
        """Take the rows that are left out for this reason from the instant of number ``begin`` on, as far as that is
        not settled. False if none are."""
        with self._lock:
            return self._recent.take_again(reason, begin)

    def _elapsed(self, stamp: int) -> float:
        """Seconds since the sample before; for another recording, or after a pause, not more than a little."""
        before, self._last_stamp = self._last_stamp, stamp
        return 0.0 if before is None else min(max(0.0, 1e-9 * (stamp - before)), LONGEST_STEP)

    def _is_still(self, speed: float, pose: FloatArray) -> bool:
        still = (
            self._last_pose is not None
            and speed < self._buffer.still_speed
            and bool(np.max(np.abs(pose - self._last_pose)) < self._buffer.still_distance)
        )
        if not still:
            self._last_pose = pose
        return still

    @property
    def rows(self) -> int:
        """Rows taken so far."""
        with self._lock:
            return self._taken

    @property
    def _taken(self) -> int:
        return self._summary.rows + self._recent.rows

    @property
    def made(self) -> int:
        """Rows made so far."""
        return self._made

    @property
    def counts(self) -> RowCounts:
        """What became of all rows so far."""
        with self._lock:
            return RowCounts(self._made, self._taken, self._rejected + self._recent.rejected)

    @property
    def rows_rejected(self) -> Counter[str]:
        """Rows that were not taken, by reason."""
        return self.counts.rejected

    def outgrown(self, rows: int, share: float) -> bool:
        """Whether more than this ``share`` of what is remembered came after so many ``rows``."""
        with self._lock:
            return self._taken - rows > share * (self._summary.weight + self._recent.rows)

    def snapshot(self) -> RowSummary:
        """A copy of all that was added so far and is not left out."""
        self._absorb()
        with self._lock:
            held = self._recent.instants
            self._summary.make_room(len(held))  # once, and not in every copy
            settled = self._summary.snapshot()
        return _with(settled, held)

    def _absorb(self) -> None:
        """Absorb what waits, releasing the lock between channels: a thread that adds meanwhile hardly waits."""
        for _ in range(self._summary.folds * len(self._summary.groups)):
            with self._lock:
                if not self._summary.absorb_one():
                    break

    def memory(self) -> Memory:
        """A copy of all that :meth:`restore` goes on from."""
        self._absorb()
        with self._lock:
            settled, held = self._summary.snapshot(), self._recent.instants
            rejected, pose, stamp = self._rejected + self._recent.rejected, self._last_pose, self._last_stamp
        return Memory(_with(settled, held).state(), rejected, pose, stamp)

    def restore(self, memory: Memory) -> None:
        """Go on from what another identifier of the same model and buffer settings remembers.

        Raises InputError, and changes nothing, for what no such identifier can remember.
        """
        robot = self.model.robot
        width = len(robot.joints) + (7 if robot.floating_base else 0)
        if memory.last_pose is not None and memory.last_pose.shape != (width,):
            raise InputError(f"a pose of shape {memory.last_pose.shape}, expected ({width},)")
        visited, width = memory.summary.visited, 3 * len(robot.joints) + (15 if robot.floating_base else 0)
        for states, expected in ((visited.kept, (3, width)), (visited.last, (width,))):
            if len(states) and states.shape[1:] != expected:
                raise InputError(f"states of a motion of shape {states.shape[1:]}, expected {expected}")
        with self._lock:
            summary = self._empty_summary()
            summary.restore(memory.summary)
            self._begin_anew()
            self._summary = summary
            self._rejected = memory.rows_rejected.copy()
            self._made = summary.rows + self._rejected.total()
            self._last_pose, self._last_stamp = memory.last_pose, memory.last_stamp

    def solve(self, warm: WarmStart | None = None) -> Estimate:
        """The estimate from all rows so far; without ``warm`` it depends on nothing else."""
        return self._solve(self._task, self.snapshot(), warm)

    def use(self, settings: EstimatorSettings) -> None:
        """Solve by these settings from now on. Raises InputError for a weighed mass that does not fit the model."""
        weighed_rows(self.model, settings.known)
        self._task = replace(self._task, settings=settings)

    def solve_with(self, solve: Solve) -> None:
        """Solve by ``solve`` instead of :meth:`EstimationTask.solve`, in another process for example."""
        self._solve = solve


def _with(summary: RowSummary, instants: Sequence[Instant]) -> RowSummary:
    """The summary, once it has these instants, too."""
    for begin in range(0, len(instants), PIECE):
        rows = (instant.rows for instant in instants[begin : begin + PIECE])
        summary.add(*map(np.array, zip(*rows, strict=True)))
    return summary
