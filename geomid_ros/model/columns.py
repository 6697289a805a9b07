"""Effect columns in samples: computed before the filter, then filtered like the efforts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from operator import itemgetter
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
        """Return its values ``(...)``, each instant independently."""


@dataclass(frozen=True)
class JointColumn:
    """A per-joint function of the joint's motion."""

    function: JointFunction

    def values(self, motion: Motion) -> FloatArray:
        """Return its values ``(N, J)``."""
        return self.function.column(motion)

    def affected_joints(self, joints: int) -> tuple[int, ...]:
        """Return the joints where it can be nonzero: all."""
        return tuple(range(joints))


@dataclass(frozen=True)
class PlacedColumn:
    """Efforts of an effect that acts on several joints at once."""

    effect: MotionEffect
    place: Place

    def values(self, motion: Motion) -> FloatArray:
        """Return efforts ``(N, J)`` per unit of its coefficient."""
        return self.effect.efforts(motion, self.place)

    def affected_joints(self, joints: int) -> tuple[int, ...]:
        """Return the joints where it can be nonzero."""
        return affected_joints(self.place, joints)


Column: TypeAlias = JointColumn | PlacedColumn


def column_of(effect: MotionEffect, place: Place) -> Column:
    """Return the column of an effect at a place."""
    return JointColumn(effect) if isinstance(effect, JointEffect) else PlacedColumn(effect, place)


def affected_joints(place: Place, joints: int) -> tuple[int, ...]:
    """Return the joints whose efforts an effect at a place affects: all for an effect of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)


@dataclass(frozen=True)
class Entries:
    """Entries of columns ``(joints, K)`` that can be nonzero: those of the joints that each column reaches, column by
    column. With effects of two joints, about half of all entries can be. Columns of one pair effect are computed at
    once; their entries come last, those of all first joints before those of all second joints."""

    columns: tuple[Column, ...]
    joints: int

    def __len__(self) -> int:
        return self._count

    def __contains__(self, column: Column) -> bool:
        return column in self._spans

    def of(self, column: Column) -> tuple[slice, tuple[int, ...]]:
        """Return the slice of a column's entries, and the joints that they belong to."""
        return self._spans[column]

    def at(self, column: Column, joint: int) -> int:
        """Return the index of a column's entry at a joint that the column reaches."""
        entries, joints = self._spans[column]
        return int(entries.start + entries.step * joints.index(joint))

    def values(self, motion: Motion) -> FloatArray:
        """Compute the values ``(N, entries)`` for a motion of arrays ``(N, joints)``."""
        values = [column.values(motion)[:, joints] for column, joints in self._single]
        for effects, joints in self._pairs:
            first, second = map(motion.of, joints)
            values += [part for effect in effects for part in effect.columns(first, second)]
        return np.concatenate([motion.position[:, :0], *values], axis=1)

    @cached_property
    def remembering(self) -> Mapping[type[JointEffect], list[JointEffect]]:
        """Effects whose columns depend on the past motion, by class."""
        by_class: dict[type[JointEffect], list[JointEffect]] = {}
        for function in (column.function for column in self.columns if isinstance(column, JointColumn)):
            if isinstance(function, JointEffect) and function.depends_on_past:
                by_class.setdefault(type(function), []).append(function)
        return by_class

    @property
    def of_own_motion(self) -> Entries:
        """Entries of the :class:`JointColumn` columns only."""
        return Entries(tuple(c for c in self.columns if isinstance(c, JointColumn)), self.joints)

    @cached_property
    def _groups(self) -> tuple[list[Column], Mapping[PairEffect, list[Column]]]:
        """Columns of pair effects, by effect, after all other columns."""
        single: list[Column] = []
        pairs: dict[PairEffect, list[Column]] = {}
        for column in self.columns:
            match column:
                case PlacedColumn(PairEffect() as effect):
                    pairs.setdefault(effect, []).append(column)
                case _:
                    single.append(column)
        return single, pairs

    @cached_property
    def _spans(self) -> Mapping[Column, tuple[slice, tuple[int, ...]]]:
        single, pairs = self._groups
        spans, begin = dict[Column, tuple[slice, tuple[int, ...]]](), 0
        for group in (*([column] for column in single), *pairs.values()):
            reached = [column.affected_joints(self.joints) for column in group]
            end = begin + sum(map(len, reached))
            for start, (column, joints) in enumerate(zip(group, reached, strict=True), begin):
                spans[column] = slice(start, end, len(group)), joints
            begin = end
        return spans

    @cached_property
    def _count(self) -> int:
        return sum(len(joints) for _, joints in self._spans.values())

    @cached_property
    def _pairs(self) -> list[tuple[list[PairEffect], IntArray]]:
        """Pair effects that act at the same pairs of joints, and these joints ``(2, columns)``."""
        groups = [(effect, [self.of(column)[1] for column in columns]) for effect, columns in self._groups[1].items()]
        same_joints = groupby(groups, key=itemgetter(1))
        return [([effect for effect, _ in same], np.array(joints).T) for joints, same in same_joints]

    @cached_property
    def _single(self) -> list[tuple[Column, slice | list[int]]]:
        """All other columns, and the joints that each reaches: a full slice if it reaches all."""
        reached = [(column, [*self.of(column)[1]]) for column in self._groups[0]]
        return [(column, slice(None) if len(at) == self.joints else at) for column, at in reached]


NO_ENTRIES = Entries((), 0)


def entries_of(effects: Iterable[tuple[MotionEffect, Place, float]], joints: int) -> tuple[Entries, FloatArray]:
    """Return the entries of the columns of ``effects``, given as (effect, place, coefficient), and a matrix ``(entries,
    joints)`` that turns their values into the effects' efforts at all ``joints``."""
    columns = [(column_of(effect, place), place, value) for effect, place, value in effects]
    entries = Entries(tuple(dict.fromkeys(column for column, _, _ in columns)), joints)
    strengths = np.zeros((len(entries), joints))
    for column, place, value in columns:
        for joint in affected_joints(place, joints):
            strengths[entries.at(column, joint), joint] += value
    return entries, strengths
