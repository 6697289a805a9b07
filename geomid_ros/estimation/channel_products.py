"""Gram matrices of the rows per channel, each on the channel's own columns.

An effort depends on the links behind its joint and on the joint's own effects, so on a robot with many limbs a channel
has few of all columns.

Rows of one channel are also kept as a triangular factor. For the rows ``[A b]`` the factor R of a QR decomposition has
``|R (x, -1)| = |A x - b|`` for every x, in at most as many rows as A has columns, plus one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from geomid_ros.geometry import compiled
from geomid_ros.types import BoolArray, FloatArray, IntArray


class Packed(NamedTuple):
    """Layout for the compiled loops: ``blocks`` one after the other, of these ``widths (C,)``; of the columns that are
    taken their ``rows`` in the block of their channel, and their ``places``; for each the end of its run of columns
    that are consecutive in both (``runs``), within the channel; ``ends (C,)`` of the channels."""

    blocks: FloatArray
    widths: IntArray
    rows: IntArray
    places: IntArray
    runs: IntArray
    ends: IntArray


def _weighed(
    packed: Packed, vector: FloatArray, counts: FloatArray, least: FloatArray, *, alone: bool = False
) -> tuple[FloatArray, FloatArray] | None:
    """As :meth:`ChannelProducts.weighed_by_squares`, of the columns that are taken; the squares ``alone``, and no sum,
    if that is said. None without compiled loops."""
    if compiled.native is None:
        return None
    squares, total = np.empty(len(packed.ends)), np.empty((0 if alone else len(vector), len(vector)))
    compiled.native.weigh(*packed, np.ascontiguousarray(vector, dtype=np.float64), counts, least, squares, total)
    return squares, total


@dataclass(frozen=True, eq=False)
class ChannelProducts:
    """Gram matrices of the columns and the target, of C channels.

    Attributes:
        size: number of columns, including the target, which is the last one.
        places: columns of each channel ``(m,)``, increasing, the target last.
        blocks: Gram matrix of each channel ``(m, m)``.
    """

    size: int
    places: tuple[IntArray, ...]
    blocks: tuple[FloatArray, ...]

    @staticmethod
    def of(size: int, channels: Iterator[tuple[IntArray, FloatArray]]) -> ChannelProducts:
        """Gram matrices from pairs of places and blocks."""
        places, blocks = zip(*channels, strict=True)
        return ChannelProducts(size, places, blocks)

    def __len__(self) -> int:
        return len(self.blocks)

    @cached_property
    def targets(self) -> FloatArray:
        """Squared norm of each channel's target ``(C,)``."""
        return np.array([block[-1, -1] for block in self.blocks])

    @cached_property
    def packed(self) -> Packed:
        """Packed layout for the compiled loops."""
        return self._packed(np.arange(self.size - 1))

    @cached_property
    def _joined(self) -> tuple[FloatArray, IntArray, IntArray]:
        """All blocks, how wide they are, and the places of their columns, one after the other."""
        widths = np.array([len(own) for own in self.places])
        return np.concatenate([block.ravel() for block in self.blocks]), widths, np.concatenate(self.places)

    def _packed(self, columns: IntArray) -> Packed:
        """The same of some ``columns``, increasing, and the target."""
        blocks, widths, places = self._joined
        new = np.full(self.size, -1)
        new[columns], new[-1] = np.arange(len(columns)), len(columns)
        (kept,) = np.nonzero(new[places] >= 0)
        at, channel = new[places[kept]], np.repeat(np.arange(len(widths)), widths)[kept]
        counts = np.bincount(channel, minlength=len(widths))
        ends = np.cumsum(counts)
        begins = np.ones(len(at) + 1, dtype=np.bool_)
        begins[1:-1] = (np.diff(at) != 1) | (np.diff(kept) != 1)
        begins[ends] = True
        breaks = np.flatnonzero(begins)
        runs = breaks[np.searchsorted(breaks, np.arange(len(at)), side="right")] - np.repeat(ends - counts, counts)
        return Packed(blocks, widths, kept - (np.cumsum(widths) - widths)[channel], at, runs, ends)

    def first(self, count: int) -> ChannelProducts:
        """The first ``count`` channels."""
        return ChannelProducts(self.size, self.places[:count], self.blocks[:count])

    def times(self, factor: float) -> ChannelProducts:
        """All blocks multiplied by ``factor``."""
        return ChannelProducts(self.size, self.places, tuple(factor * block for block in self.blocks))

    def select(self, columns: IntArray) -> SelectedProducts:
        """Those of some ``columns``, increasing, and the target."""
        return SelectedProducts(self, columns)

    def dense(self, channel: int) -> FloatArray:
        """Gram matrix of one channel over all columns ``(size, size)``."""
        found, own = np.zeros((self.size, self.size)), self.places[channel]
        found[own[:, None], own] = self.blocks[channel]
        return found

    def squares(self, vector: FloatArray) -> FloatArray:
        """Squared norm per channel ``(C,)`` of the columns times ``vector (size,)``."""
        nothing = np.zeros(len(self))
        if (found := _weighed(self.packed, vector, nothing, nothing, alone=True)) is not None:
            return found[0]
        pairs = zip(self.places, self.blocks, strict=True)
        return np.array([float(vector[own] @ block @ vector[own]) for own, block in pairs])

    def weighed(self, weights: Sequence[float] | FloatArray) -> FloatArray:
        """Weighted sum of the Gram matrices ``(size, size)``, for ``weights (C,)``."""
        if compiled.native is not None:
            return self.weighed_by_squares(np.zeros(self.size), np.asarray(weights), np.ones(len(self)))[1]
        total = np.zeros((self.size, self.size))
        for weight, own, block in zip(weights, self.places, self.blocks, strict=True):
            total[own[:, None], own] += weight * block
        return total

    def some(self, columns: IntArray, weights: FloatArray) -> FloatArray:
        """The rows of the weighted sum for some ``columns``, ``(len(columns), size)``."""
        total, rows = np.zeros((len(columns), self.size)), self._rows[:, columns]
        for channel in np.flatnonzero(np.any(rows >= 0, axis=1)).tolist():
            (found,) = np.nonzero(rows[channel] >= 0)
            own, block = self.places[channel], self.blocks[channel]
            total[found[:, None], own] += weights[channel] * block[rows[channel, found]]
        return total

    @cached_property
    def _rows(self) -> IntArray:
        """The row of each column in each channel's block ``(C, size)``; -1 where the channel does not have it."""
        rows = np.full((len(self), self.size), -1)
        for own, places in zip(rows, self.places, strict=True):
            own[places] = np.arange(len(places))
        return rows

    def weighed_by_squares(
        self, vector: FloatArray, counts: FloatArray, least: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Squared norms ``(C,)`` at ``vector (size,)``; and the sum of the Gram matrices weighted by ``counts`` over
        these, with the lower bound ``least (C,)``."""
        if (found := _weighed(self.packed, vector, counts, least)) is not None:
            return found
        squares = self.squares(vector)
        return squares, self.weighed(counts / np.maximum(squares, least))


@dataclass(frozen=True, eq=False)
class SelectedProducts:
    """Those of some ``columns (k,)`` of the ``whole``, increasing, and the target. The compiled loops copy nothing."""

    whole: ChannelProducts
    columns: IntArray

    @property
    def targets(self) -> FloatArray:
        """See :class:`ChannelProducts`."""
        return self.whole.targets

    @cached_property
    def packed(self) -> Packed:
        """Packed layout for the compiled loops."""
        return self.whole._packed(self.columns)  # noqa: SLF001 of which it is a part

    @cached_property
    def _copied(self) -> ChannelProducts:
        new = np.full(self.whole.size, -1)
        new[self.columns], new[-1] = np.arange(len(self.columns)), len(self.columns)
        pairs = [(np.flatnonzero(new[own] >= 0), own) for own in self.whole.places]
        places = tuple(new[own[kept]] for kept, own in pairs)
        blocks = zip(pairs, self.whole.blocks, strict=True)
        return ChannelProducts(
            len(self.columns) + 1, places, tuple(block[kept[:, None], kept] for (kept, _), block in blocks)
        )

    def squares(self, vector: FloatArray) -> FloatArray:
        """See :class:`ChannelProducts`; ``vector (k + 1,)``."""
        nothing = np.zeros(len(self.whole))
        found = _weighed(self.packed, vector, nothing, nothing, alone=True)
        return self._copied.squares(vector) if found is None else found[0]

    def weighed_by_squares(
        self, vector: FloatArray, counts: FloatArray, least: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :class:`ChannelProducts`; ``vector (k + 1,)``."""
        found = _weighed(self.packed, vector, counts, least)
        return self._copied.weighed_by_squares(vector, counts, least) if found is None else found


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
