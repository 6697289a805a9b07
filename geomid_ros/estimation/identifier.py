"""Identifier, which the node and the command line use: samples in, estimates out."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.linalg import LinAlgError

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import usable
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart, estimate
from geomid_ros.estimation.fit import INDEPENDENT_ROWS_PER_PERIOD
from geomid_ros.estimation.revocable_buffer import BufferedSample, RevocableBuffer
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.samples import SAMPLES_PER_PIECE, Samples, regimes
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.types import BoolArray, FloatArray, IntArray

NOT_MEASURED = "not measured"
STANDING_STILL = "standing still"
LONGEST_STEP = 1.0
"""Longest time [s] between two rows; a longer pause counts as this."""


@dataclass(frozen=True)
class BufferSettings:
    """Rows to take, and how long they count. Raises InputError for invalid values.

    Attributes:
        still_speed, still_distance: A sample has no new information and is not taken if nothing moves faster than this
            [rad/s or m/s] and the pose is nearer than this [rad or m] to the last one taken.
        forgetting_time: Time constant [s] with which the weight of earlier rows falls while rows are taken; infinite to
            forget nothing.
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
            raise InputError(
                f"folds is {self.folds} and block is {self.block}; folds must be even and at least 2, block at least 1"
            )


@dataclass(frozen=True, eq=False)
class Memory:
    """State of an :class:`Identifier`: rows, numbers of rejected ones by reason, last pose taken, last stamp [ns]."""

    summary: SummaryState
    rows_rejected: Counter[str]
    last_pose: FloatArray | None
    last_stamp: int | None


@dataclass(frozen=True, eq=False)
class RowCounts:
    """Numbers of rows since the last reset: taken, and rejected by reason."""

    taken: int
    rejected: Counter[str]

    @property
    def made(self) -> int:
        """Number of all rows."""
        return self.taken + self.rejected.total()


@dataclass(frozen=True, eq=False)
class EstimationTask:
    """Estimation problem without its rows: the arguments of :func:`estimate`."""

    model: MeasurementModel
    settings: EstimatorSettings
    prior: FloatArray | None

    def solve(
        self, summary: RowSummary, warm: WarmStart | None, passing: Callable[[Estimate], bool] = lambda _: False
    ) -> Estimate:
        """Estimate from these rows; without ``warm`` it depends on nothing else. ``passing``: see :func:`estimate`.
        Raises InputError if it cannot be computed."""
        try:
            return estimate(self.model, summary, self.settings, self.prior, warm, passing=passing)
        except LinAlgError as error:
            raise InputError(BEYOND_PRECISION) from error


BEYOND_PRECISION = (
    "the efforts are too far from those that any links would need to be computed in double precision: check their unit "
    "(effort_gain, --gain), and that the recording and the URDF are of the same robot"
)
"""Why nothing can be estimated from data that no robot sends."""

Solve: TypeAlias = Callable[[EstimationTask, RowSummary, WarmStart | None], Estimate]


class Identifier:
    """Accumulate rows of samples, and solve for the parameters. One thread may add while another solves.

    Samples with new rows are counted (:attr:`sample_count`). Rows of some channels can be left out from a sample on, as
    if they had never been taken. This holds for samples that are buffered (:meth:`buffer_last`) and not settled yet.
    Estimates use all rows that are not left out.
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
        self.sample_count = 0
        """Number of samples with new rows so far: the number of the next one."""
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._summary = self._empty_summary()
        self._recent = RevocableBuffer()
        self._rejected: Counter[str] = Counter()
        self._last_pose: FloatArray | None = None
        self._last_stamp: int | None = None

    def _empty_summary(self) -> RowSummary:
        buffer = self._buffer
        apart = 1.0 / (INDEPENDENT_ROWS_PER_PERIOD * self._task.settings.cutoff)
        return RowSummary(self.model.channels, buffer.folds, buffer.block, buffer.forgetting_time, apart)

    def reset(self) -> None:
        """Forget all samples, and which rows are left out. The count of samples continues."""
        with self._lock:
            self._begin_anew()

    def add(self, samples: Samples, absent_columns: slice = slice(0)) -> tuple[BoolArray, Rows, BoolArray]:
        """Add samples, in the order of time.

        Args:
            samples: the samples.
            absent_columns: parameters of a body that the robot did not carry then.

        Returns:
            True for samples ``(N,)`` that are not standing still; their rows; and ``(n, channels)``, true for efforts
            of their joints that move slowly, at rest or near a reversal: dry friction may be below its full level
            there.
        """
        rows = self.model.rows(samples)
        rows.coefficients[:, :, absent_columns] = 0.0
        motion_regimes = np.zeros(rows.targets.shape, dtype=np.int64)  # of efforts those of their joint, else 0
        if self.model.layout.efforts:
            motion_regimes[:, self.model.layout.efforts] = regimes(samples)
        is_measured = usable(rows.coefficients, rows.targets)
        counts, targets = np.count_nonzero(is_measured, axis=1), np.where(is_measured, rows.targets, np.nan)
        speeds = np.max(np.abs(np.concatenate([samples.velocity, samples.base_velocity], axis=1)), axis=1)
        poses = np.concatenate([samples.position, samples.base_pose], axis=1)
        with self._lock:
            self._rejected[NOT_MEASURED] += is_measured.size - int(np.sum(counts))
            moved: slice | BoolArray = slice(None)  # a slice copies nothing
            still = np.array([self._is_still(*pair) for pair in zip(speeds.tolist(), poses, strict=True)], dtype=bool)
            if np.any(still):
                self._rejected[STANDING_STILL] += int(np.sum(counts[still]))
                moved = ~still
            taken, motion_regimes = Rows(rows.coefficients[moved], rows.targets[moved]), motion_regimes[moved]
            targets, elapsed, states = targets[moved], self._elapsed(samples.stamps)[moved], samples.states[moved]
            if self._held == 0 and self._recent.idle:  # the buffer would only pass them on
                self._summary.add(taken.coefficients, targets, elapsed, motion_regimes, states)
                self.sample_count += len(elapsed)
            else:
                for instant in zip(taken.coefficients, targets, elapsed.tolist(), motion_regimes, states, strict=True):
                    self._recent.append(BufferedSample(self.sample_count, *instant))
                    self.sample_count += 1
                self._settle_before(self.sample_count - self._held)
        return ~still, taken, motion_regimes > 0

    def _settle_before(self, number: float) -> None:
        settled = list[BufferedSample]()
        while self._recent.first < number:
            instant, rejected = self._recent.pop()
            self._rejected += rejected
            settled.append(instant)
        _with(self._summary, settled)

    def buffer_last(self, instants: int) -> None:
        """Buffer the last ``instants`` samples (none at first), whose rows can still be left out; settle the
        rest."""
        with self._lock:
            self._held = instants
            self._settle_before(self.sample_count - instants)

    def settle(self, before: int) -> None:
        """Settle samples ``before`` this number: their rows stay. Another thread that adds meanwhile hardly waits."""
        while True:
            with self._lock:
                if self._recent.first >= before:
                    break
                self._settle_before(min(before, self._recent.first + SAMPLES_PER_PIECE))

    def leave_out(self, reason: str, channels: Sequence[int], begin: int) -> bool:
        """Leave out the rows of ``channels`` from sample number ``begin`` on, unless settled.

        They count as rejected for this ``reason``. Returns False if they were left out before.
        """
        with self._lock:
            return self._recent.leave_out(reason, channels, begin)

    def restore_rows(self, reason: str, begin: int) -> bool:
        """Take the rows that are left out for this reason from sample number ``begin`` on, unless settled. Returns
        False if there are none."""
        with self._lock:
            return self._recent.restore_rows(reason, begin)

    def _elapsed(self, stamps: IntArray) -> FloatArray:
        """Seconds since the sample before ``(N,)``: 0 if time goes back or for the first sample, at most
        :data:`LONGEST_STEP`."""
        before = stamps[:1] if self._last_stamp is None else [self._last_stamp]
        if len(stamps):
            self._last_stamp = int(stamps[-1])
        return np.clip(1e-9 * np.diff(stamps, prepend=before), 0.0, LONGEST_STEP)

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
        """Number of rows taken so far."""
        with self._lock:
            return self._taken

    @property
    def _taken(self) -> int:
        return self._summary.rows + self._recent.rows

    @property
    def counts(self) -> RowCounts:
        """Numbers of all rows so far, taken and rejected."""
        with self._lock:
            return RowCounts(self._taken, self._rejected + self._recent.rejected)

    def has_grown_beyond(self, rows: int, share: float) -> bool:
        """True if more than this fraction ``share`` of the rows in memory came after the first ``rows`` rows."""
        with self._lock:
            return self._taken - rows > share * (self._summary.weight + self._recent.rows)

    def snapshot(self) -> RowSummary:
        """Copy of all rows so far that are not left out."""
        with self._lock:
            buffered = self._recent.instants
            self._summary.make_room(len(buffered))  # once, and not in every copy
            settled = self._summary.snapshot()
        return _with(settled, buffered)

    def memory(self) -> Memory:
        """Copy of the state for :meth:`restore`. What is added later has the same effect here and there, to the last
        bit: no rows wait here, either."""
        with self._lock:
            self._summary.absorb()
            settled, buffered = self._summary.snapshot(), self._recent.instants
            rejected, pose, stamp = self._rejected + self._recent.rejected, self._last_pose, self._last_stamp
        return Memory(_with(settled, buffered).state(), rejected, pose, stamp)

    def restore(self, memory: Memory) -> None:
        """Continue from the state of another identifier with the same model and buffer settings.

        Raises InputError, and changes nothing, for a state that no such identifier can have.
        """
        robot = self.model.robot
        width = len(robot.joints) + (7 if robot.floating_base else 0)
        if memory.last_pose is not None and memory.last_pose.shape != (width,):
            raise InputError(f"last pose has shape {memory.last_pose.shape}, expected ({width},)")
        visited, width = memory.summary.visited, 3 * len(robot.joints) + (15 if robot.floating_base else 0)
        for states, expected in ((visited.kept, (3, width)), (visited.last, (width,))):
            if len(states) and states.shape[1:] != expected:
                raise InputError(f"states of the motion have shape {states.shape[1:]}, expected {expected}")
        with self._lock:
            summary = self._empty_summary()
            summary.restore(memory.summary)
            self._begin_anew()
            self._summary = summary
            self._rejected = memory.rows_rejected.copy()
            self._last_pose, self._last_stamp = memory.last_pose, memory.last_stamp

    def solve(self, warm: WarmStart | None = None) -> Estimate:
        """Estimate from all rows so far; without ``warm`` it depends on nothing else."""
        return self._solve(self._task, self.snapshot(), warm)

    def solve_unless(self, passing: Callable[[Estimate], bool]) -> Estimate:
        """Like :meth:`solve`, but fit no files to an estimate that is ``passing``: rows will be made anew by it."""
        return self._task.solve(self.snapshot(), None, passing)

    def use(self, settings: EstimatorSettings) -> None:
        """Use these settings from now on. Raises InputError for a weighed mass that does not fit the model."""
        weighed_rows(self.model, settings.known)
        self._task = replace(self._task, settings=settings)

    def solve_with(self, solve: Solve) -> None:
        """Solve by ``solve`` instead of :meth:`EstimationTask.solve`, for example in another process."""
        self._solve = solve


def _with(summary: RowSummary, instants: Sequence[BufferedSample]) -> RowSummary:
    """Add samples with rows to the summary, and return it. Earlier rows do not age by the others."""
    with_rows = [instant for instant in instants if np.any(np.isfinite(instant.targets))]
    for begin in range(0, len(with_rows), SAMPLES_PER_PIECE):
        rows = (instant.rows for instant in with_rows[begin : begin + SAMPLES_PER_PIECE])
        summary.add(*map(np.array, zip(*rows, strict=True)))
    return summary
