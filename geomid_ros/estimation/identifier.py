"""The one object that the node and the command line drive: samples in, estimates out."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, WarmStart, estimate
from geomid_ros.estimation.summary import RowSummary, usable
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

NOT_MEASURED = "not measured"
STANDING_STILL = "standing still"


@dataclass(frozen=True)
class BufferSettings:
    """``still_speed`` [rad/s or m/s] and ``still_distance`` [rad or m]: an instant at which nothing moves faster, and
    that lies nearer to the last one taken, says nothing new. ``forgetting``: factor per row on the weight of earlier
    rows of its channel (1: nothing is forgotten). ``folds``, ``block``: see :class:`RowSummary`."""

    still_speed: float = 1e-3
    still_distance: float = 1e-2
    forgetting: float = 1.0
    folds: int = 8
    block: int = 100

    def __post_init__(self) -> None:
        if not 0.0 < self.forgetting <= 1.0:
            raise InputError(f"forgetting is {self.forgetting:g}, expected a factor above 0 and up to 1")
        if self.folds < 1 or self.block < 1:
            raise InputError(f"{self.folds} folds of {self.block} instants, expected at least one of each")


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
        """``prior (D,)``: start from these parameters instead of the URDF's (see :func:`estimate`)."""
        self.model = model
        self.rows_rejected: Counter[str] = Counter()
        self._estimator = estimator or EstimatorSettings()
        self._buffer = buffer or BufferSettings()
        self._prior = prior
        self._last_pose: FloatArray | None = None
        self._lock = threading.Lock()
        self._summary = self._empty_summary()

    def _empty_summary(self) -> RowSummary:
        buffer = self._buffer
        return RowSummary(self.model.channels, buffer.folds, buffer.block, buffer.forgetting)

    def reset(self) -> None:
        """Forget all samples."""
        with self._lock:
            self._summary = self._empty_summary()
            self.rows_rejected.clear()
            self._last_pose = None

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time."""
        rows = self.model.rows(samples)
        with self._lock:
            for index in range(len(samples)):
                measured = usable(rows.coefficients[index], rows.targets[index])
                self.rows_rejected[NOT_MEASURED] += int(np.count_nonzero(~measured))
                if self._is_still(samples, index):
                    self.rows_rejected[STANDING_STILL] += int(np.count_nonzero(measured))
                else:
                    self._summary.add(rows.coefficients[index], rows.targets[index])

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

    def snapshot(self) -> RowSummary:
        """A copy of all that was added so far."""
        with self._lock:
            return self._summary.snapshot()

    def solve(self, warm: WarmStart | None = None) -> Estimate:
        """The estimate from all rows so far; without ``warm`` it depends on nothing else."""
        return estimate(self.model, self.snapshot(), self._estimator, self._prior, warm)
