"""The columns of effects that samples carry: computed before the filter, and filtered as the efforts are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from geomid_ros.model.effects import JointEffect, JointMotion, Motion, MotionEffect, OnRobot, Place, joints_of
from geomid_ros.types import FloatArray


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
        return np.stack([self.function.column(motion.of(joint)) for joint in range(motion.joints)], axis=-1)


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
        for index, column in enumerate(self.columns):
            values[..., index] = column.values(motion)
        return values


NO_COLUMNS = Columns()


def reached_joints(place: Place, joints: int) -> tuple[int, ...]:
    """The joints at whose efforts an effect at a place is felt: all for one of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)
