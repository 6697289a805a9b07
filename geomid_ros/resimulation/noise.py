"""An example of the sensors' noise, whose effect on a simulation is the unit of its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.gap.result import GapResult
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Noise:
    """An example of the noise in every channel: ``values (M, channels)`` [N m, N] every ``period`` [s], NaN where a
    channel is not measured."""

    channels: tuple[str, ...]
    period: float
    values: FloatArray

    @staticmethod
    def of(result: GapResult) -> Noise:
        """What the final model leaves of the held-out data, scaled to the noise floor: its size is the floor's, its
        colour and what channels have in common are those of the remainder."""
        remainder = result.trace.measured - result.trace.after
        counts = np.count_nonzero(np.isfinite(remainder), axis=0)
        size = np.sqrt(np.nansum(remainder**2, axis=0) / np.maximum(counts, 1))
        scale = np.divide(result.floor, size, out=np.full(len(size), np.nan), where=size > 0.0)
        period = 1e-9 * float(np.median(np.diff(result.trace.stamps)))
        return Noise(result.channels, period, scale * remainder)

    @property
    def duration(self) -> float:
        """Length of the example [s]."""
        return len(self.values) * self.period

    def at(self, times: FloatArray, shift: float) -> FloatArray:
        """The noise at ``times (...)`` [s], begun ``shift`` [s] later and repeated without end, ``(..., channels)``."""
        place = (np.asarray(times) + shift) / self.period
        first = np.floor(place).astype(np.int64)
        share = (place - first)[..., None]
        count = len(self.values)
        return (1.0 - share) * self.values[first % count] + share * self.values[(first + 1) % count]

    def only(self, names: Sequence[str]) -> Noise:
        """The noise of these channels; none where it is not known."""
        silent = np.zeros(len(self.values))
        found = [self.values[:, self.channels.index(name)] if name in self.channels else silent for name in names]
        return Noise(tuple(names), self.period, np.nan_to_num(np.stack(found, axis=1)))
