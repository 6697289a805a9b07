"""The contract of a physical effect whose strength is identified along with the inertias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One joint's motion over N instants, each ``(N,)``, in rad, rad/s, rad/s^2 (or m, m/s, m/s^2)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Effect(ABC):
    """An effect adds ``coefficient * column(motion)`` to a joint's effort, with one coefficient per joint.

    ``positive`` coefficients live on P(1) (they cannot change sign, the metric is dc^2/c^2), the others on a real
    line. ``units`` are those of the coefficient for a revolute and for a prismatic joint.
    """

    name: ClassVar[str]
    positive: ClassVar[bool]
    units: ClassVar[tuple[str, str]]

    @abstractmethod
    def column(self, motion: JointMotion) -> FloatArray:
        """Effort per unit of the coefficient, ``(N,)``."""
