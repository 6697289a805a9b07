"""Effect columns in samples: computed before the filter, then filtered like the efforts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, TypeAlias

import numpy as np

from geomid_ros.model.effects import JointEffect, JointMotion, Motion, MotionEffect, OnRobot, Place, joints_of
from geomid_ros.types import FloatArray


class JointFunction(Protocol):
    """A function of one joint's motion."""

    def column(self, motion: JointMotion) -> FloatArray:
        """Return its values ``(...)``, each instant independently."""


@dataclass(frozen=True)
class JointColumn:
    """A per-joint function of the joint's motion."""

    function: JointFunction
    place: ClassVar[Place] = OnRobot()

    def values(self, motion: Motion) -> FloatArray:
        """Return its values ``(N, J)``."""
        return self.function.column(motion)

    def at_joints(self, motion: Motion) -> FloatArray | Sequence[FloatArray]:
        """Return its values ``(N,)`` at each joint."""
        return self.values(motion).T


@dataclass(frozen=True)
class PlacedColumn:
    """Efforts of an effect that acts on several joints at once."""

    effect: MotionEffect
    place: Place

    def values(self, motion: Motion) -> FloatArray:
        """Return efforts ``(N, J)`` per unit of its coefficient."""
        return self.effect.efforts(motion, self.place)

    def at_joints(self, motion: Motion) -> FloatArray | Sequence[FloatArray]:
        """Return efforts ``(N,)`` at the joints that the effect affects."""
        return self.effect.at_joints(motion, self.place)


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
    column. With effects of two joints, about half of all entries can be."""

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
        return int(entries.start) + joints.index(joint)

    def values(self, motion: Motion) -> FloatArray:
        """Compute the values ``(N, entries)`` for a motion of arrays ``(N, joints)``."""
        values = np.empty((len(self), len(motion.position)))
        for column, (entries, _) in self._spans.items():
            values[entries] = column.at_joints(motion)
        return values.T

    @cached_property
    def remembering(self) -> Mapping[type[JointEffect], list[JointEffect]]:
        """Effects whose columns depend on the past motion, by class."""
        by_class: dict[type[JointEffect], list[JointEffect]] = {}
        for function in (column.function for column in self.columns if isinstance(column, JointColumn)):
            if isinstance(function, JointEffect) and function.depends_on_past:
                by_class.setdefault(type(function), []).append(function)
        return by_class

    @cached_property
    def _count(self) -> int:
        return sum(len(joints) for _, joints in self._spans.values())

    @cached_property
    def _spans(self) -> Mapping[Column, tuple[slice, tuple[int, ...]]]:
        spans, begin = dict[Column, tuple[slice, tuple[int, ...]]](), 0
        for column in self.columns:
            joints = affected_joints(column.place, self.joints)
            spans[column] = slice(begin, begin + len(joints)), joints
            begin += len(joints)
        return spans


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
