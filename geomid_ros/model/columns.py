"""The columns of effects that samples carry: computed before the filter, and filtered as the efforts are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np

from geomid_ros.model.effects import (
    JointEffect,
    JointMotion,
    Motion,
    MotionEffect,
    OnRobot,
    PairEffect,
    Place,
    joints_of,
)
from geomid_ros.types import FloatArray, IntArray


class JointFunction(Protocol):
    """A function of one joint's motion."""

    def column(self, motion: JointMotion) -> FloatArray:
        """Its values ``(...)``, at each instant by itself."""


@dataclass(frozen=True)
class JointColumn:
    """A function of every joint's own motion."""

    function: JointFunction

    def values(self, motion: Motion) -> FloatArray:
        """Its values ``(N, J)``."""
        return self.function.column(JointMotion(motion.position, motion.velocity, motion.acceleration))


@dataclass(frozen=True)
class PlacedColumn:
    """The efforts of an effect that acts on several joints at once."""

    effect: MotionEffect
    place: Place

    def values(self, motion: Motion) -> FloatArray:
        """Efforts ``(N, J)`` per unit of its coefficient."""
        return self.effect.efforts(motion, self.place)


Column: TypeAlias = JointColumn | PlacedColumn


def column_of(effect: MotionEffect, place: Place) -> Column:
    """The column in which an effect at a place is found."""
    return JointColumn(effect) if isinstance(effect, JointEffect) else PlacedColumn(effect, place)


@dataclass(frozen=True)
class Columns:
    """The columns of samples, in their order."""

    columns: tuple[Column, ...] = ()

    @staticmethod
    def of(columns: Iterable[Column]) -> Columns:
        """Each column once."""
        return Columns(tuple(dict.fromkeys(columns)))

    def __len__(self) -> int:
        return len(self.columns)

    def values(self, motion: Motion) -> FloatArray:
        """``(N, J, K)`` for a motion, each ``(N, J)``."""
        entries = Entries(self, motion.position.shape[1])
        return entries.spread(entries.values(motion))

    @cached_property
    def place(self) -> Mapping[Column, int]:
        """Where each column stands."""
        return {column: index for index, column in enumerate(self.columns)}


NO_COLUMNS = Columns()


def reached_joints(place: Place, joints: int) -> tuple[int, ...]:
    """The joints at whose efforts an effect at a place is felt: all for one of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)


class Entries:
    """Which entries of columns ``(J, K)`` can be other than zero, the joints that a column reaches, one column after
    the other: half of them where there are effects of two joints."""

    def __init__(self, columns: Columns, joints: int) -> None:
        self._shape = joints, len(columns)
        reached = [_reached(column, joints) for column in columns.columns]
        starts = np.cumsum([0, *map(len, reached)]).tolist()
        self._places = np.array(
            [joint * len(columns) + place for place, own in enumerate(reached) for joint in own], dtype=np.int64
        )
        pairs: dict[PairEffect, list[tuple[int, ...]]] = {}
        self._alone: list[tuple[slice, IntArray, Column]] = []
        for start, own, column in zip(starts, reached, columns.columns, strict=False):
            if isinstance(column, PlacedColumn) and isinstance(column.effect, PairEffect):
                pairs.setdefault(column.effect, []).append((start, *own))
            else:
                self._alone.append((slice(start, start + len(own)), np.array(own), column))
        # Of each effect of two joints, the first of the two entries of each column, and the joints: all pairs at once.
        self._pairs = {effect: np.array(own).T for effect, own in pairs.items()}

    def __len__(self) -> int:
        return len(self._places)

    def values(self, motion: Motion) -> FloatArray:
        """``(N, entries)`` for a motion, each ``(N, J)``."""
        values = np.empty((len(motion.position), len(self)))
        for entries, joints, column in self._alone:
            values[:, entries] = column.values(motion)[:, joints]
        for effect, (start, first, second) in self._pairs.items():
            values[:, start], values[:, start + 1] = effect.columns(motion.of(first), motion.of(second))
        return values

    def spread(self, values: FloatArray) -> FloatArray:
        """The columns ``(N, J, K)`` with these entries ``(N, entries)``."""
        columns = np.zeros((len(values), self._shape[0] * self._shape[1]))
        columns[:, self._places] = values
        return columns.reshape(len(values), *self._shape)


def _reached(column: Column, joints: int) -> tuple[int, ...]:
    return reached_joints(column.place, joints) if isinstance(column, PlacedColumn) else tuple(range(joints))
