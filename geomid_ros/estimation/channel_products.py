"""Gram matrices of each channel's columns.

An effort depends on the links distal to its joint and on the joint's effects, so on a robot with many limbs a channel
has few of all columns.

Rows of one channel are also kept as a triangular factor. For the rows ``[A b]`` the factor R of a QR decomposition has
``|R (x, -1)| = |A x - b|`` for every x, in at most as many rows as A has columns, plus one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType
from typing import NamedTuple, cast

import numpy as np

from geomid_ros.geometry import compiled
from geomid_ros.types import BoolArray, FloatArray, IntArray


class PackedBlocks(NamedTuple):
    """Layout for the compiled loops: all ``blocks`` in one array, and their ``widths (C,)``. Per selected column: its
    row in the block of its channel (``rows``), its place in the result (``places``), and the end of its run of columns
    within the channel that are consecutive in both (``runs``). ``ends (C,)`` of the channels."""

    blocks: FloatArray
    widths: IntArray
    rows: IntArray
    places: IntArray
    runs: IntArray
    ends: IntArray


class _Products(ABC):
    """Gram matrices of the columns in use and the target, of C channels."""

    @property
    @abstractmethod
    def packed(self) -> PackedBlocks:
        """Packed layout for the compiled loops."""

    @property
    @abstractmethod
    def by_channel(self) -> Iterable[tuple[IntArray, FloatArray]]:
        """Columns of each channel among those in use ``(m,)``, and their Gram matrix ``(m, m)``."""

    def squares(self, vector: FloatArray) -> FloatArray:
        """Squared norm per channel ``(C,)`` of the columns times ``vector (columns,)``, the last one the target."""
        if compiled.native is None:
            return np.array([float(vector[places] @ block @ vector[places]) for places, block in self.by_channel])
        nothing = np.zeros(len(self.packed.ends))
        return _weighed(compiled.native, self.packed, vector, nothing, nothing, np.empty((0, len(vector))))

    def weighed_by_squares(
        self, vector: FloatArray, counts: FloatArray, least: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Squared norms ``(C,)`` at ``vector (columns,)``, and the sum of the Gram matrices weighted by ``counts`` over
        these, which are bounded below by ``least (C,)``."""
        if compiled.native is not None:
            total = np.empty((len(vector), len(vector)))
            return _weighed(compiled.native, self.packed, vector, counts, least, total), total
        squares, total = self.squares(vector), np.zeros((len(vector), len(vector)))
        weights = counts / np.maximum(squares, least)
        for weight, (places, block) in zip(weights, self.by_channel, strict=True):
            total[places[:, None], places] += weight * block
        return squares, total


def _weighed(
    native: ModuleType, packed: PackedBlocks, vector: FloatArray, counts: FloatArray, least: FloatArray, out: FloatArray
) -> FloatArray:
    """Squared norms by the compiled loops, which also write the weighted sum into ``out`` unless that is empty."""
    squares = np.empty(len(counts))
    native.weigh(*packed, np.ascontiguousarray(vector, dtype=np.float64), counts, least, squares, out)
    return squares


@dataclass(frozen=True, eq=False)
class ChannelProducts(_Products):
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
    def of(size: int, channels: Iterable[tuple[IntArray, FloatArray]]) -> ChannelProducts:
        """Build from pairs of places and blocks."""
        places, blocks = zip(*channels, strict=True)
        return ChannelProducts(size, places, blocks)

    def __len__(self) -> int:
        return len(self.blocks)

    @cached_property
    def targets(self) -> FloatArray:
        """Squared norm of each channel's target ``(C,)``."""
        return np.array([block[-1, -1] for block in self.blocks])

    @cached_property
    def packed(self) -> PackedBlocks:
        """Packed layout for the compiled loops."""
        return self._packed(np.arange(self.size - 1))

    @cached_property
    def _joined(self) -> tuple[FloatArray, IntArray, IntArray]:
        """All blocks in one array, their widths, and the places of their columns in one array."""
        widths = np.array([len(places) for places in self.places])
        return np.concatenate([block.ravel() for block in self.blocks]), widths, np.concatenate(self.places)

    def _packed(self, columns: IntArray) -> PackedBlocks:
        """Packed layout for some ``columns``, increasing, and the target."""
        blocks, widths, places = self._joined
        new_places = self.new_places(columns)
        (kept,) = np.nonzero(new_places[places] >= 0)
        at, channel = new_places[places[kept]], np.repeat(np.arange(len(widths)), widths)[kept]
        counts = np.bincount(channel, minlength=len(widths))
        ends = np.cumsum(counts)
        begins = np.ones(len(at) + 1, dtype=np.bool_)
        begins[1:-1] = (np.diff(at) != 1) | (np.diff(kept) != 1)
        begins[ends] = True
        breaks = np.flatnonzero(begins)
        runs = breaks[np.searchsorted(breaks, np.arange(len(at)), side="right")] - np.repeat(ends - counts, counts)
        return PackedBlocks(blocks, widths, kept - (np.cumsum(widths) - widths)[channel], at, runs, ends)

    def new_places(self, columns: IntArray) -> IntArray:
        """Place ``(size,)`` of each column among some ``columns``, increasing, and the target; -1 if not among them."""
        places = np.full(self.size, -1)
        places[columns], places[-1] = np.arange(len(columns)), len(columns)
        return places

    def select(self, columns: IntArray) -> SelectedProducts:
        """Gram matrices of some ``columns``, increasing, and the target."""
        return SelectedProducts(self, columns)

    @property
    def by_channel(self) -> Iterable[tuple[IntArray, FloatArray]]:
        """Columns of each channel, and their Gram matrix."""
        return zip(self.places, self.blocks, strict=True)

    def weighed(self, weights: Sequence[float] | FloatArray) -> FloatArray:
        """Weighted sum of the Gram matrices ``(size, size)``, for ``weights (C,)``."""
        weights = np.asarray(weights, dtype=np.float64)
        return self.weighed_by_squares(np.zeros(self.size), weights, np.ones(len(weights)))[1]

    def some(self, columns: IntArray, weights: FloatArray) -> FloatArray:
        """Rows of the weighted sum for some ``columns``, ``(len(columns), size)``."""
        total, rows = np.zeros((len(columns), self.size)), self._rows[:, columns]
        for channel in np.flatnonzero(np.any(rows >= 0, axis=1)).tolist():
            (selected,) = np.nonzero(rows[channel] >= 0)
            places, block = self.places[channel], self.blocks[channel]
            total[selected[:, None], places] += weights[channel] * block[rows[channel, selected]]
        return total

    def having(self, columns: IntArray) -> IntArray:
        """Channels ``(n,)`` in which some of ``columns`` is not zero."""
        return np.flatnonzero(np.any(self._nonzero[:, columns], axis=1))

    @cached_property
    def _nonzero(self) -> BoolArray:
        """True for the columns that are not zero in a channel ``(C, size)``."""
        nonzero = np.zeros((len(self), self.size), dtype=np.bool_)
        for of_channel, places, block in zip(nonzero, self.places, self.blocks, strict=True):
            of_channel[places] = np.diagonal(block) > 0.0
        return nonzero

    def combined(self, channel: int, combinations: FloatArray) -> FloatArray:
        """Gram matrix ``(k, k)`` of linear ``combinations (size, k)`` of the columns and the target of a channel."""
        weights = combinations[self.places[channel]]
        (used,) = np.nonzero(np.any(weights, axis=1))
        return np.asarray(weights[used].T @ self.blocks[channel][used[:, None], used] @ weights[used])

    @cached_property
    def _rows(self) -> IntArray:
        """Row of each column in each channel's block ``(C, size)``; -1 if the channel does not have it."""
        rows = np.full((len(self), self.size), -1)
        for block_rows, places in zip(rows, self.places, strict=True):
            block_rows[places] = np.arange(len(places))
        return rows


@dataclass(frozen=True, eq=False)
class SelectedProducts(_Products):
    """Gram matrices of some ``columns (k,)`` of the ``whole``, increasing, and the target. No copies if compiled."""

    whole: ChannelProducts
    columns: IntArray

    @property
    def targets(self) -> FloatArray:
        """See :class:`ChannelProducts`."""
        return self.whole.targets

    @cached_property
    def packed(self) -> PackedBlocks:
        """Packed layout for the compiled loops."""
        return self.whole._packed(self.columns)  # noqa: SLF001 same module

    @cached_property
    def by_channel(self) -> Iterable[tuple[IntArray, FloatArray]]:
        """Columns of each channel among the selected ones, and their Gram matrix."""
        new_places = self.whole.new_places(self.columns)
        pairs = [(new_places[places], block) for places, block in self.whole.by_channel]
        return [(places[places >= 0], block[places >= 0][:, places >= 0]) for places, block in pairs]


@dataclass
class ChannelSummary:
    """Rows of one channel: the factor ``(<= columns + 1, columns + 1)`` of ``[A b]``, and the sum of their weights.

    ``time``: last time [s] at which the weights were updated. ``waiting``: blocks ``(n, columns + 2)`` of rows that are
    not yet in the factor: ``[A b]``, and each row's time [s].
    """

    factor: FloatArray
    count: float = 0.0
    time: float = 0.0
    waiting: list[FloatArray] = field(default_factory=list)

    def copy(self) -> ChannelSummary:
        """Copy that later changes of this one do not affect; no array is ever changed in place."""
        return ChannelSummary(self.factor, self.count, self.time, [*self.waiting])

    @property
    def waiting_rows(self) -> int:
        """Number of rows that are not yet in the factor."""
        return sum(map(len, self.waiting))

    def absorb(self, count: int, now: float, forgetting_time: float) -> None:
        """Add the first ``count`` waiting rows to the factor. A row's weight at the time ``now`` [s] is
        ``exp(-age / forgetting_time)``."""
        remaining = float(np.exp((self.time - now) / forgetting_time))
        if remaining < 1.0:  # otherwise copies share the factor
            self.factor = np.sqrt(remaining) * self.factor
            self.count *= remaining
        if count:
            rows, *rest = np.split(np.concatenate(self.waiting), [count])
            weights = np.exp((rows[:, -1] - now) / forgetting_time)
            self.factor = triangular(np.concatenate([self.factor, np.sqrt(weights)[:, None] * rows[:, :-1]]))
            self.count += float(np.sum(weights))
            self.waiting = rest
        self.time = now


def joined(parts: Sequence[ChannelSummary]) -> FloatArray:
    """Return one factor for all ``parts`` (at least one) of a channel."""
    return triangular(np.concatenate([part.factor for part in parts]))


def together(parts: Sequence[ChannelSummary]) -> ChannelSummary:
    """Merge ``parts`` (at least one) of a channel, whose weights are of the same time."""
    return ChannelSummary(joined(parts), sum(part.count for part in parts), parts[0].time)


def usable(coefficients: FloatArray, targets: FloatArray) -> BoolArray:
    """True for rows ``(..., D)`` with finite target ``(...)`` and coefficients: one NaN would spoil all."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(targets) & np.isfinite(np.sum(coefficients, axis=-1)))  # finite only if all are


def triangular(matrix: FloatArray) -> FloatArray:
    """The factor R of a QR decomposition: ``|R x| = |matrix x|`` for every x."""
    return cast(FloatArray, np.linalg.qr(matrix, mode="r"))
