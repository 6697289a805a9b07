"""The contract of physical effects, and of those whose strength is identified along with the inertias."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

from geomid_ros.model.effects.parameters import ParameterForm
from geomid_ros.types import FloatArray

Place: TypeAlias = Literal["joint", "robot", "link", "sensor"]


class PhysicalEffect:
    """What every effect says of itself; results, reports and files take it from here.

    ``label``: what it is called within a sentence. ``meaning``: the equation, in terms of its ``parameters``, of a
    joint's position q, velocity v and acceleration a, and of the effort tau that its gear transmits to the link.
    ``settled_by``: the recording that tells it from its rivals, as the gap workflow recommends it. ``place``: where it
    acts. ``adds_up``: two at one place are one with the sums of their parameters.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    meaning: ClassVar[str]
    parameters: ClassVar[tuple[ParameterForm, ...]]
    settled_by: ClassVar[str]
    place: ClassVar[Place] = "joint"
    adds_up: ClassVar[bool] = True


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One joint's motion over N instants, each ``(N,)``, in rad, rad/s, rad/s^2 (or m, m/s, m/s^2)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Effect(PhysicalEffect, ABC):
    """An effect adds ``coefficient * column(motion)`` to a joint's effort, with one coefficient per joint.

    If that is its only parameter it can be identified, and is in :data:`geomid_ros.model.effects.EFFECTS`.
    """

    @property
    def positive(self) -> bool:
        """Whether the coefficient lives on P(1) (it cannot change sign, the metric is dc^2/c^2), not on a real line: a
        parameter that must be above zero does."""
        return self.parameters[0].above == 0.0

    @property
    def units(self) -> tuple[str, str]:
        """Units of the coefficient at a revolute and at a prismatic joint."""
        return self.parameters[0].units

    @abstractmethod
    def column(self, motion: JointMotion) -> FloatArray:
        """Effort per unit of the coefficient, ``(N,)``, at each instant by itself."""
