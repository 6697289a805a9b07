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
        values = np.zeros((*motion.position.shape, len(self.columns)))
        for index, column in self._alone:
            values[..., index] = column.values(motion)
        for effect, (places, first, second) in self._pairs.items():
            at_first, at_second = effect.columns(motion.of(first), motion.of(second))
            values[..., first, places], values[..., second, places] = at_first, at_second
        return values

    @cached_property
    def place(self) -> Mapping[Column, int]:
        """Where each column stands."""
        return {column: index for index, column in enumerate(self.columns)}

    @cached_property
    def _pairs(self) -> dict[PairEffect, tuple[IntArray, IntArray, IntArray]]:
        """Of each effect of two joints: the places of its columns, and the two joints of each."""
        found: dict[PairEffect, list[tuple[int, ...]]] = {}
        for index, column in enumerate(self.columns):
            if isinstance(column, PlacedColumn) and isinstance(column.effect, PairEffect):
                found.setdefault(column.effect, []).append((index, *joints_of(column.place)))
        arrays = {effect: np.array(own).T for effect, own in found.items()}
        return {effect: (places, first, second) for effect, (places, first, second) in arrays.items()}

    @cached_property
    def _alone(self) -> list[tuple[int, Column]]:
        """The other columns, with their places."""
        paired = {int(place) for places, _, _ in self._pairs.values() for place in places}
        return [(index, column) for index, column in enumerate(self.columns) if index not in paired]


NO_COLUMNS = Columns()


def reached_joints(place: Place, joints: int) -> tuple[int, ...]:
    """The joints at whose efforts an effect at a place is felt: all for one of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)
