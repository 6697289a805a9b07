"""The columns of effects that samples carry: computed before the filter, and filtered as the efforts are."""

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
        """Its values ``(...)``, at each instant by itself."""


@dataclass(frozen=True)
class JointColumn:
    """A function of every joint's own motion."""

    function: JointFunction

    def values(self, motion: Motion) -> FloatArray:
        """Its values ``(N, J)``."""
        return self.function.column(motion)

    def reached(self, joints: int) -> tuple[int, ...]:
        """The joints where it can be other than zero: all."""
        return tuple(range(joints))


@dataclass(frozen=True)
class PlacedColumn:
    """The efforts of an effect that acts on several joints at once."""

    effect: MotionEffect
    place: Place

    def values(self, motion: Motion) -> FloatArray:
        """Efforts ``(N, J)`` per unit of its coefficient."""
        return self.effect.efforts(motion, self.place)

    def reached(self, joints: int) -> tuple[int, ...]:
        """The joints where it can be other than zero."""
        return reached_joints(self.place, joints)


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
    one column after the other. Of columns with effects of two joints they are half; those of one such effect, which are
    computed at once, come last, the entries of all first joints before those of the second ones."""

    columns: tuple[Column, ...]
    joints: int

    def __len__(self) -> int:
        return self._count

    def __contains__(self, column: Column) -> bool:
        return column in self._places

    def of(self, column: Column) -> tuple[slice, tuple[int, ...]]:
        """Where the entries of one of the columns are, and at which joints."""
        return self._places[column]

    def at(self, column: Column, joint: int) -> int:
        """The entry of one of the columns at a joint that it reaches."""
        own, joints = self._places[column]
        return int(own.start + own.step * joints.index(joint))

    def values(self, motion: Motion) -> FloatArray:
        """``(N, entries)`` for a motion, each ``(N, joints)``."""
        values = [column.values(motion)[:, joints] for column, joints in self._alone]
        for effects, joints in self._pairs:
            first, second = map(motion.of, joints)
            values += [part for effect in effects for part in effect.columns(first, second)]
        return np.concatenate([motion.position[:, :0], *values], axis=1)

    @cached_property
    def remembering(self) -> Mapping[type[JointEffect], list[JointEffect]]:
        """The effects whose columns depend on the motion before, too, by their class."""
        found: dict[type[JointEffect], list[JointEffect]] = {}
        for function in (column.function for column in self.columns if isinstance(column, JointColumn)):
            if isinstance(function, JointEffect) and function.remembers:
                found.setdefault(type(function), []).append(function)
        return found

    @property
    def of_own_motion(self) -> Entries:
        """Those of the columns that are functions of each joint's own motion."""
        return Entries(tuple(c for c in self.columns if isinstance(c, JointColumn)), self.joints)

    @cached_property
    def _together(self) -> Mapping[Column | PairEffect, list[Column]]:
        """The columns, those of an effect of two joints together, after all others."""
        alone: dict[Column | PairEffect, list[Column]] = {}
        pairs: dict[Column | PairEffect, list[Column]] = {}
        for column in self.columns:
            match column:
                case PlacedColumn(PairEffect() as effect):
                    pairs.setdefault(effect, []).append(column)
                case _:
                    alone[column] = [column]
        return alone | pairs

    @cached_property
    def _places(self) -> Mapping[Column, tuple[slice, tuple[int, ...]]]:
        places, begin = dict[Column, tuple[slice, tuple[int, ...]]](), 0
        for several in self._together.values():
            reached = [column.reached(self.joints) for column in several]
            end = begin + sum(map(len, reached))
            for place, (column, joints) in enumerate(zip(several, reached, strict=True), begin):
                places[column] = slice(place, end, len(several)), joints
            begin = end
        return places

    @cached_property
    def _count(self) -> int:
        return sum(len(joints) for _, joints in self._places.values())

    @cached_property
    def _pairs(self) -> list[tuple[list[PairEffect], IntArray]]:
        """Effects of the same pairs of joints, and these ``(2, columns)``."""
        found = [
            (effect, [column.reached(self.joints) for column in several])
            for effect, several in self._together.items()
            if isinstance(effect, PairEffect)
        ]
        return [
            ([effect for effect, _ in same], np.array(joints).T) for joints, same in groupby(found, key=itemgetter(1))
        ]

    @cached_property
    def _alone(self) -> list[tuple[Column, slice | list[int]]]:
        """The other columns, and the joints that each reaches: a slice if these are all."""
        alone = [column for column in self._together if not isinstance(column, PairEffect)]
        reached = [[*column.reached(self.joints)] for column in alone]
        return [(c, slice(None) if len(own) == self.joints else own) for c, own in zip(alone, reached, strict=True)]


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
