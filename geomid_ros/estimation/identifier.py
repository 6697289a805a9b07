"""The one object that the node and the command line drive: samples in, estimates out."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart, estimate
from geomid_ros.estimation.summary import RowSummary, SummaryState, usable
from geomid_ros.model.known import known_rows
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

NOT_MEASURED = "not measured"
STANDING_STILL = "standing still"
_LONGEST_STEP = 1.0  # [s]
_RENEWED = 1.0 / 3.0


@dataclass(frozen=True)
class BufferSettings:
    """``still_speed`` [rad/s or m/s] and ``still_distance`` [rad or m]: an instant at which nothing moves faster, and
    that lies nearer to the last one taken, says nothing new. ``forgetting_time`` [s]: time constant with which the
    weight of earlier rows falls while rows are taken (infinite: nothing is forgotten). ``folds``, ``block``: see
    :class:`RowSummary`."""

    still_speed: float = 1e-3
    still_distance: float = 1e-2
    forgetting_time: float = np.inf
    folds: int = 8
    block: int = 100

    def __post_init__(self) -> None:
        if not self.forgetting_time > 0.0:
            raise InputError(f"forgetting time is {self.forgetting_time:g} s, expected a number greater than zero")
        if self.folds < 1 or self.block < 1:
            raise InputError(f"{self.folds} folds of {self.block} instants, expected at least one of each")


@dataclass(frozen=True, eq=False)
class Memory:
    """All that an :class:`Identifier` remembers: rows, why others were not taken, and the last pose and stamp [ns]."""

    summary: SummaryState
    rows_rejected: Counter[str]
    last_pose: FloatArray | None
    last_stamp: int | None


class Identifier:
    """Accumulates samples' rows and solves for the parameters. One thread may add while another solves.

    ``rows_rejected`` counts by reason the rows that were not taken.
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
        self.rows_rejected: Counter[str] = Counter()
        self._estimator = estimator or EstimatorSettings()
        self._buffer = buffer or BufferSettings()
        known_rows(model, self._estimator.known)
        self._prior = prior
        self._last_pose: FloatArray | None = None
        self._last_stamp: int | None = None
        self._lock = threading.Lock()
        self._summary = self._empty_summary()

    def _empty_summary(self) -> RowSummary:
        buffer = self._buffer
        return RowSummary(self.model.channels, buffer.folds, buffer.block, buffer.forgetting_time)

    def reset(self) -> None:
        """Forget all samples."""
        with self._lock:
            self._summary = self._empty_summary()
            self.rows_rejected.clear()
            self._last_pose = self._last_stamp = None

    def add(self, samples: Samples) -> tuple[IntArray, Rows]:
        """Take samples, in the order of time; returns stamps and rows of those that are not standing still."""
        rows = self.model.rows(samples)
        moving = np.zeros(len(samples), dtype=bool)
        with self._lock:
            for index in range(len(samples)):
                elapsed = self._elapsed(int(samples.stamps[index]))
                measured = usable(rows.coefficients[index], rows.targets[index])
                self.rows_rejected[NOT_MEASURED] += int(np.count_nonzero(~measured))
                if self._is_still(samples, index):
                    self.rows_rejected[STANDING_STILL] += int(np.count_nonzero(measured))
                else:
                    moving[index] = True
                    self._summary.add(rows.coefficients[index], rows.targets[index], elapsed)
        return samples.stamps[moving], Rows(rows.coefficients[moving], rows.targets[moving])

    def _elapsed(self, stamp: int) -> float:
        """Seconds since the sample before; for another recording, or after a pause, not more than a little."""
        before, self._last_stamp = self._last_stamp, stamp
        return 0.0 if before is None else min(max(0.0, 1e-9 * (stamp - before)), _LONGEST_STEP)

    def _is_still(self, samples: Samples, index: int) -> bool:
        speed = np.max(np.abs(np.append(samples.velocity[index], samples.base_velocity[index])))
        pose = np.append(samples.position[index], samples.base_pose[index])
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
            return self._summary.rows

    def outgrown(self, rows: int) -> bool:
        """Whether what was chosen when there were ``rows`` rows should be chosen anew: a third of what is remembered
        came later."""
        with self._lock:
            return self._summary.rows - rows > _RENEWED * self._summary.weight

    def snapshot(self) -> RowSummary:
        """A copy of all that was added so far."""
        self._absorb()
        with self._lock:
            return self._summary.snapshot()

    def _absorb(self) -> None:
        """Absorb what waits, and give the lock away between one channel and the next: who adds meanwhile hardly
        waits."""
        for _ in range(self._summary.folds * len(self.model.channels)):
            with self._lock:
                if not self._summary.absorb_one():
                    break

    def memory(self) -> Memory:
        """A copy of all that :meth:`restore` goes on from."""
        self._absorb()
        with self._lock:
            return Memory(self._summary.state(), self.rows_rejected.copy(), self._last_pose, self._last_stamp)

    def restore(self, memory: Memory) -> None:
        """Go on from what another identifier of the same model and buffer settings remembers.

        Raises InputError, and changes nothing, for what no such identifier can remember.
        """
        robot = self.model.robot
        width = len(robot.joints) + (7 if robot.floating_base else 0)
        if memory.last_pose is not None and memory.last_pose.shape != (width,):
            raise InputError(f"a pose of shape {memory.last_pose.shape}, expected ({width},)")
        with self._lock:
            self._summary.restore(memory.summary)
            self.rows_rejected = memory.rows_rejected.copy()
            self._last_pose, self._last_stamp = memory.last_pose, memory.last_stamp

    def solve(self, warm: WarmStart | None = None) -> Estimate:
        """The estimate from all rows so far; without ``warm`` it depends on nothing else."""
        return estimate(self.model, self.snapshot(), self._estimator, self._prior, warm)
