"""What a robot does, and what a model says of it, at some instants: all that effects' columns are functions of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from geomid_ros.model.effects.places import Place, joints_of
from geomid_ros.types import FloatArray, IntArray


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

    def of(self, joint: int | IntArray) -> JointMotion:
        """The motion of one joint, or of several, ``(..., n)``."""
        return JointMotion(self.position[..., joint], self.velocity[..., joint], self.acceleration[..., joint])

    @property
    def joints(self) -> int:
        """J."""
        return int(self.position.shape[-1])


OfLoad: TypeAlias = Callable[[FloatArray, float], FloatArray]
"""Makes ``(n, J, K)`` of the gears' load ``(n, J)`` at all instants of a recording, which are one period [s] apart."""
Derivatives: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Values and their first and second derivatives by time, filtered as the samples are, each ``(N, J, K)``."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of C channels at N instants by the links' motion, ``(N, C, J)``, and by gravity in the base frame,
    ``(N, C, 3)``."""

    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_gravity: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Situation(Sensitivity):
    """What a model says of N instants, J joints and C channels, of which the first J are the joints' efforts.

    Attributes:
        sign: direction of motion ``(N, J)``.
        predicted: the channels' values, effects included ``(N, C)``.
        load, load_rate, load_acceleration: efforts that move the rigid bodies and their derivatives by time ``(N, J)``.
        transmitted: all that the gears transmit ``(N, J)``: the same efforts, friction and springs behind the gears.
        gravity: gravity in the frame of a base that stands straight ``(3,)`` [m/s^2].
        coefficients: those of the effects that the model has, by the effect's name and place.
        of_load: what a function makes of the load's history, at the N instants.
    """

    sign: FloatArray
    predicted: FloatArray
    load: FloatArray
    load_rate: FloatArray
    load_acceleration: FloatArray
    transmitted: FloatArray
    gravity: FloatArray
    coefficients: Mapping[tuple[str, Place], FloatArray]
    of_load: Callable[[OfLoad], Derivatives]

    def column_of(self, joints: int | slice, efforts: FloatArray) -> FloatArray:
        """A column ``(N, C, 1)`` of which only the ``efforts`` of these joints are not zero."""
        column = np.zeros((*self.predicted.shape, 1))
        column[:, joints, 0] = efforts
        return column

    def behind(self, joint: int, moved: FloatArray, rate: FloatArray, acceleration: FloatArray) -> FloatArray:
        """The column ``(N, C, 1)`` of a joint's link that is behind the measured position by ``moved (N,)``, whose
        derivatives by time are ``rate`` and ``acceleration``."""
        return -(
            self.by_position[:, :, joint, None] * moved[:, None, None]
            + self.by_velocity[:, :, joint, None] * rate[:, None, None]
            + self.by_acceleration[:, :, joint, None] * acceleration[:, None, None]
        )

    def usual_load(self, place: Place) -> float:
        """Standard deviation of what the gear of a place's (first) joint transmits [N m or N]; 0 without a joint."""
        return float(np.std(self.load[:, joints_of(place)[0]])) if joints_of(place) else 0.0
