"""The columns of effects that samples carry: computed before the filter, and filtered as the efforts are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
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
        return self.function.column(motion)


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


def reached_joints(place: Place, joints: int) -> tuple[int, ...]:
    """The joints at whose efforts an effect at a place is felt: all for one of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)


@dataclass(frozen=True)
class Entries:
    """The entries of columns ``(joints, K)`` that can be other than zero: those of the joints that a column reaches,
    one column after the other. Of columns with effects of two joints they are half."""

    columns: tuple[Column, ...]
    joints: int

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __contains__(self, column: Column) -> bool:
        return column in self._place

    @cached_property
    def _place(self) -> Mapping[Column, int]:
        return {column: index for index, column in enumerate(self.columns)}

    def of(self, column: Column) -> tuple[slice, tuple[int, ...]]:
        """Where the entries of one of the columns are, and at which joints."""
        place = self._place[column]
        return slice(self._starts[place], self._starts[place + 1]), self._reached[place]

    def at(self, column: Column, joint: int) -> int:
        """The entry of one of the columns at a joint that it reaches."""
        place = self._place[column]
        return self._starts[place] + self._reached[place].index(joint)

    def values(self, motion: Motion) -> FloatArray:
        """``(N, entries)`` for a motion, each ``(N, joints)``."""
        values = np.empty((len(motion.position), len(self)))
        for column, entries, joints in self._alone:
            values[:, entries] = column.values(motion)[:, joints]
        for effect, (start, first, second) in self._pairs.items():
            values[:, start], values[:, start + 1] = effect.columns(motion.of(first), motion.of(second))
        return values

    @cached_property
    def remembering(self) -> tuple[JointEffect, ...]:
        """The effects whose columns depend on the motion before, too."""
        own = (column.function for column in self.columns if isinstance(column, JointColumn))
        return tuple(effect for effect in own if isinstance(effect, JointEffect) and effect.remembers)

    @property
    def of_own_motion(self) -> Entries:
        """Those of the columns that are functions of each joint's own motion."""
        return Entries(tuple(c for c in self.columns if isinstance(c, JointColumn)), self.joints)

    @cached_property
    def _reached(self) -> list[tuple[int, ...]]:
        return [
            reached_joints(column.place, self.joints) if isinstance(column, PlacedColumn) else tuple(range(self.joints))
            for column in self.columns
        ]

    @cached_property
    def _starts(self) -> list[int]:
        return list(accumulate(map(len, self._reached), initial=0))

    @cached_property
    def _pairs(self) -> dict[PairEffect, IntArray]:
        """Of each effect of two joints ``(3, columns)``: the first of the two entries of each column, and the two
        joints; all are computed at once."""
        found: dict[PairEffect, list[tuple[int, ...]]] = {}
        for start, reached, column in zip(self._starts, self._reached, self.columns, strict=False):
            if isinstance(column, PlacedColumn) and isinstance(column.effect, PairEffect):
                found.setdefault(column.effect, []).append((start, *reached))
        return {effect: np.array(own).T for effect, own in found.items()}

    @cached_property
    def _alone(self) -> list[tuple[Column, slice, slice | list[int]]]:
        """The other columns, where the entries of each are, and at which joints: a slice if that is at all of them."""
        alone = [c for c in self.columns if not (isinstance(c, PlacedColumn) and c.effect in self._pairs)]
        places = [(column, *self.of(column)) for column in alone]
        return [(c, own, slice(None) if len(joints) == self.joints else [*joints]) for c, own, joints in places]


NO_ENTRIES = Entries((), 0)


def entries_of(effects: Iterable[tuple[MotionEffect, Place, float]], joints: int) -> tuple[Entries, FloatArray]:
    """The entries of the columns of effects, each at a place with its coefficient; and what these add to the efforts of
    all ``joints`` per unit of each ``(entries, joints)``."""
    found = [(column_of(effect, place), place, value) for effect, place, value in effects]
    entries = Entries(tuple(dict.fromkeys(column for column, _, _ in found)), joints)
    strengths = np.zeros((len(entries), joints))
    for column, place, value in found:
        for joint in reached_joints(place, joints):
            strengths[entries.at(column, joint), joint] += value
    return entries, strengths
