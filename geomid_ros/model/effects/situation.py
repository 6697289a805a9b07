"""What a robot does, and what a model says of it, at some instants: all that effects' columns are functions of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.places import Place, joints_of
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One joint's motion, each ``(...)``, in rad, rad/s, rad/s^2 (or m, m/s, m/s^2)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True, eq=False)
class Motion:
    """All J joints' motion, each ``(..., J)``, in rad, rad/s, rad/s^2 (or m, m/s, m/s^2)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def of(self, joint: int) -> JointMotion:
        """The motion of one joint."""
        return JointMotion(self.position[..., joint], self.velocity[..., joint], self.acceleration[..., joint])

    @property
    def joints(self) -> int:
        """J."""
        return int(self.position.shape[-1])


@dataclass(frozen=True, eq=False, kw_only=True)
class Situation:
    """What a model says of N instants, J joints and C channels, of which the first J are the joints' efforts.

    Attributes:
        sign: direction of motion ``(N, J)``.
        predicted, rate: the channels' values, effects included, and their derivative by time ``(N, C)``.
        load, load_rate, load_acceleration: efforts that the gears transmit to the links (rigid bodies alone) and their
            derivatives by time ``(N, J)``.
        side, side_rate, side_acceleration: the side of their play on which the gears are, -1 to 1, for each of K
            :data:`geomid_ros.model.effects.backlash.CROSSINGS`, with its derivatives by time ``(N, J, K)``.
        by_position, by_velocity, by_acceleration: derivatives of the channels by the links' motion ``(N, C, J)``.
        by_gravity: derivatives of the channels by gravity in the base frame ``(N, C, 3)``.
        gravity: gravity in the frame of a base that stands straight ``(3,)`` [m/s^2].
        coefficients: those of the effects that the model has, by the effect's name and place.
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
    by_gravity: FloatArray
    gravity: FloatArray
    coefficients: Mapping[tuple[str, Place], FloatArray]

    def usual_load(self, place: Place) -> float:
        """Standard deviation of what the gear of a place's (first) joint transmits [N m or N]; 0 without a joint."""
        return float(np.std(self.load[:, joints_of(place)[0]])) if joints_of(place) else 0.0
