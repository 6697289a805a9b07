"""A bounded memory of any number of rows: their least-squares content, kept by QR.

For the rows ``[A b]`` of one channel the triangular factor R of a QR decomposition has ``|R (x, -1)| = |A x - b|`` for
every x, in at most as many rows as A has columns, plus one. Factors of different channels are kept apart, because
their standard deviations are only known later, and so are those of different *folds* of time, so that what was not
used for a fit can judge it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.model.measurement import Channel
from geomid_ros.types import FloatArray


@dataclass
class ChannelSummary:
    """The rows of one channel: the factor ``(<= columns + 1, columns + 1)`` of ``[A b]``, and how many they were."""

    factor: FloatArray
    count: float = 0.0

    def add(self, rows: FloatArray, targets: FloatArray, forgetting: float) -> None:
        """Add rows ``(N, columns)``; all earlier ones count ``forgetting**N`` as much."""
        fade = forgetting ** len(targets)
        augmented = np.column_stack([rows, targets])
        stacked = np.concatenate([np.sqrt(fade) * self.factor, augmented])
        self.factor = np.linalg.qr(stacked, mode="r")
        self.count = fade * self.count + len(targets)

    def squared_error(self, parameters: FloatArray) -> float:
        """``|A x - b|^2`` at parameters ``(columns,)``."""
        return float(np.sum((self.factor @ np.append(parameters, -1.0)) ** 2))


class RowSummary:
    """Summaries of all channels in ``folds`` folds: blocks of ``block`` instants go to the folds in turn."""

    # Rows wait until so many are there: a QR of many at once costs less than one of each.
    _CHUNK = 128

    def __init__(self, channels: Sequence[Channel], folds: int = 4, block: int = 100, forgetting: float = 1.0) -> None:
        self.channels = tuple(channels)
        self.folds = folds
        self._block = block
        self._forgetting = forgetting
        self._instants = 0
        self._summaries = [[ChannelSummary(np.zeros((0, len(c.columns) + 1))) for c in self.channels] for _ in range(folds)]
        self._waiting: list[list[list[tuple[FloatArray, float]]]] = [[[] for _ in self.channels] for _ in range(folds)]

    def add(self, coefficients: FloatArray, targets: FloatArray) -> None:
        """Add one instant's rows: ``coefficients (channels, D)``, ``targets (channels,)``, NaN where not measured."""
        fold = self._instants // self._block % self.folds
        self._instants += 1
        for index in np.flatnonzero(np.isfinite(targets)):
            waiting = self._waiting[fold][index]
            waiting.append((coefficients[index, self.channels[index].columns], float(targets[index])))
            if len(waiting) >= self._CHUNK:
                self._absorb(fold, int(index))

    def _absorb(self, fold: int, index: int) -> None:
        waiting = self._waiting[fold][index]
        if waiting:
            rows, targets = zip(*waiting, strict=True)
            self._summaries[fold][index].add(np.array(rows), np.array(targets), self._forgetting)
            waiting.clear()

    def parts(self, folds: Sequence[int] | None = None) -> list[list[ChannelSummary]]:
        """Per channel the summaries of the chosen folds (all unless given), everything added so far included."""
        chosen = range(self.folds) if folds is None else folds
        for fold in chosen:
            for index in range(len(self.channels)):
                self._absorb(fold, index)
        return [[self._summaries[fold][index] for fold in chosen] for index in range(len(self.channels))]

    def snapshot(self) -> RowSummary:
        """A copy that later additions do not change."""
        copy = RowSummary(self.channels, self.folds, self._block, self._forgetting)
        copy._instants = self._instants
        copy._summaries = [[replace(part) for part in fold] for fold in self._parts_by_fold()]
        return copy

    def _parts_by_fold(self) -> list[list[ChannelSummary]]:
        return [list(fold) for fold in zip(*self.parts(), strict=True)]

    @property
    def rows(self) -> int:
        """Number of rows added (faded ones counted by their weight)."""
        waiting = sum(len(channel) for fold in self._waiting for channel in fold)
        return round(sum(s.count for fold in self._summaries for s in fold)) + waiting

    def rms(self, parameters: FloatArray, folds: Sequence[int] | None = None) -> FloatArray:
        """Root mean square of each channel's residual at parameters ``(D,)``, ``(channels,)``; NaN without rows."""
        result = np.full(len(self.channels), np.nan)
        for index, (channel, parts) in enumerate(zip(self.channels, self.parts(folds), strict=True)):
            count = sum(part.count for part in parts)
            if count > 0.0:
                errors = sum(part.squared_error(parameters[channel.columns]) for part in parts)
                result[index] = np.sqrt(errors / count)
        return result

    def compressed(
        self, sigmas: FloatArray, dimension: int, folds: Sequence[int] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Rows ``(<= D + 1, D)`` and targets with standard deviation 1 and the least-squares content of the folds.

        ``sigmas (channels,)`` divide the channels' rows. The last row of the factor, in which no parameter appears, is
        left out: it is the part of the residual that no parameter can change.
        """
        stacked = [np.zeros((0, dimension + 1))]
        for channel, sigma, parts in zip(self.channels, sigmas, self.parts(folds), strict=True):
            for part in parts:
                if len(part.factor):
                    widened = np.zeros((len(part.factor), dimension + 1))
                    widened[:, channel.columns] = part.factor[:, :-1] / sigma
                    widened[:, -1] = part.factor[:, -1] / sigma
                    stacked.append(widened)
        factor = np.linalg.qr(np.concatenate(stacked), mode="r")[:dimension]
        return factor[:, :-1], factor[:, -1]
