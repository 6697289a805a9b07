"""Rows of one channel as a triangular factor.

For the rows ``[A b]`` the factor R of a QR decomposition has ``|R (x, -1)| = |A x - b|`` for every x, in at most as
many rows as A has columns, plus one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from geomid_ros.types import BoolArray, FloatArray


@dataclass
class ChannelSummary:
    """Rows of one channel: the factor ``(<= columns + 1, columns + 1)`` of ``[A b]``, and the sum of their weights.

    ``time``: when the weights were last brought up to date [s].
    """

    factor: FloatArray
    count: float = 0.0
    time: float = 0.0

    def copy(self) -> ChannelSummary:
        """A copy that later changes of this one do not change; no array is ever changed in place."""
        return ChannelSummary(self.factor, self.count, self.time)

    def fade(self, share: float) -> None:
        """Multiply the weights of all rows by ``share``."""
        self.factor = np.sqrt(share) * self.factor
        self.count *= share

    def add(self, rows: FloatArray, targets: FloatArray, weights: FloatArray) -> None:
        """Add rows ``(N, columns)`` with ``weights (N,)``."""
        augmented = np.sqrt(weights)[:, None] * np.column_stack([rows, targets])
        self.factor = triangular(np.concatenate([self.factor, augmented]))
        self.count += float(np.sum(weights))


def joined(parts: Sequence[ChannelSummary]) -> FloatArray:
    """One factor for all ``parts`` (at least one) of a channel."""
    return triangular(np.concatenate([part.factor for part in parts]))


def together(parts: Sequence[ChannelSummary]) -> ChannelSummary:
    """All ``parts`` (at least one) of a channel, whose weights are of the same time."""
    return ChannelSummary(joined(parts), sum(part.count for part in parts), parts[0].time)


def usable(coefficients: FloatArray, targets: FloatArray) -> BoolArray:
    """Which rows ``(..., D)`` have a target ``(...)`` and coefficients that are numbers: one NaN would spoil all."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(targets) & np.isfinite(np.sum(coefficients, axis=-1)))  # a sum of numbers is one


def triangular(matrix: FloatArray) -> FloatArray:
    """The factor R of a QR decomposition: ``|R x| = |matrix x|`` for every x."""
    return cast(FloatArray, np.linalg.qr(matrix, mode="r"))
