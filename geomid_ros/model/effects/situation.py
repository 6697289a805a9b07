"""The contract of an effect that depends on what a model says of a motion, not on one joint's motion alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from geomid_ros.model.effects.effect import PhysicalEffect
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class Situation:
    """What a model says of N instants, J joints and C channels, of which the first J are the joints' efforts.

    ``sign (N, J)``: direction of motion. ``predicted (N, C)``: the channels' values, effects included; ``rate (N, C)``
    their derivative by time. ``load, load_rate, load_acceleration (N, J)``: efforts that the gears transmit to the
    links (rigid bodies alone) and their derivatives by time; ``side (N, J, K)``: the side of their play on which the
    gears are, -1 to 1, for each of K :data:`geomid_ros.model.effects.backlash.CROSSINGS`, with its derivatives.
    ``by_position, by_velocity, by_acceleration (N, C, J)``: derivatives of the channels by the links' motion;
    ``by_tilt (N, C, 2)`` by the base's rotation vector (x, y) [rad].
    """

    sign: FloatArray
    predicted: FloatArray
    rate: FloatArray
    load: FloatArray
    load_rate: FloatArray
    load_acceleration: FloatArray
    side: FloatArray
    side_rate: FloatArray
    side_acceleration: FloatArray
    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_tilt: FloatArray


class SituationEffect(PhysicalEffect, ABC):
    """An effect adds ``coefficients . columns(situation, joint)`` to the channels, to first order in the coefficients.

    ``positive``: the coefficient cannot be negative.
    """

    positive: ClassVar[bool]

    @abstractmethod
    def columns(self, situation: Situation, joint: int) -> FloatArray:
        """Change of the channels per unit of each coefficient, ``(N, C, coefficients)``."""
