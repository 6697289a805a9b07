"""What effects' columns are functions of: where an effect acts, and what a robot does, and what a model says of it, at
some instants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from geomid_ros.types import FloatArray, IntArray

PlaceKind: TypeAlias = Literal["joint", "joints", "robot", "link", "sensor", "base", "commands"]


@dataclass(frozen=True)
class AtJoint:
    """At one joint, by its index."""

    joint: int


@dataclass(frozen=True)
class AtJoints:
    """At two joints, by their indices."""

    first: int
    second: int


@dataclass(frozen=True)
class OnRobot:
    """On the whole robot."""


@dataclass(frozen=True)
class OnLink:
    """On an identified link, by its place among these; ``joint`` moves it, None for a base that none moves."""

    link: int
    joint: int | None


@dataclass(frozen=True)
class AtSensor:
    """At a wrench sensor, by its topic, or on a floating base: some of its axes are the ``channels`` (range of indices)
    of the measurement model."""

    topic: str
    channels: tuple[int, ...]


Place: TypeAlias = AtJoint | AtJoints | OnRobot | OnLink | AtSensor


def joints_of(place: Place) -> tuple[int, ...]:
    """The joints at which a place is: none for the whole robot and for sensors."""
    match place:
        case AtJoint(joint):
            return (joint,)
        case AtJoints(first, second):
            return (first, second)
        case OnLink(_, joint):
            return () if joint is None else (joint,)
    return ()


def place_named(kind: PlaceKind, name: str, joints: Sequence[str]) -> Place | None:
    """The place of effects of joints or of the whole robot that files call ``name``, among ``joints``; None if there
    is none."""
    if kind == "joint" and name in joints:
        return AtJoint(joints.index(name))
    pairs = ((a, b) for a in range(len(joints)) for b in range(len(joints)) if a != b)
    if kind == "joints":
        return next((AtJoints(a, b) for a, b in pairs if pair_name(joints[a], joints[b]) == name), None)
    return OnRobot() if kind in ("robot", "commands") else None


def pair_name(first: str, second: str) -> str:
    """What files and tables call a place at two joints."""
    return f"{first}+{second}"


def joint_of(place: Place) -> int:
    """The joint of a place at one joint."""
    (joint,) = joints_of(place)
    return joint


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One joint's motion: its position, velocity and acceleration ``(3, ...)`` in rad, rad/s, rad/s^2 (or m, m/s,
    m/s^2); and what effects remember of the motion before, by the effect, where that is known."""

    states: FloatArray
    past: Mapping[Any, FloatArray] = field(default_factory=dict)

    @property
    def position(self) -> FloatArray:
        """``(...)`` [rad or m]."""
        return np.asarray(self.states[0])

    @property
    def velocity(self) -> FloatArray:
        """``(...)`` [rad/s or m/s]."""
        return np.asarray(self.states[1])

    @property
    def acceleration(self) -> FloatArray:
        """``(...)`` [rad/s^2 or m/s^2]."""
        return np.asarray(self.states[2])


class Motion(JointMotion):
    """All J joints' motion ``(3, ..., J)``: that of one joint, for all at once."""

    def of(self, joint: int | IntArray) -> JointMotion:
        """The motion of one joint, or of several, ``(..., n)``."""
        past = {effect: state.take(joint, axis=-1) for effect, state in self.past.items()}
        return JointMotion(self.states.take(joint, axis=-1), past)

    @property
    def joints(self) -> int:
        """J."""
        return int(self.states.shape[-1])


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
