"""Arguments of effect columns: the place of an effect, the motion of the robot, and the state of a model, for N
samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np

from geomid_ros.types import FloatArray

PlaceKind: TypeAlias = Literal["joint", "joints", "robot", "link", "sensor", "base", "commands"]


@dataclass(frozen=True)
class AtJoint:
    """Place at one joint, by its index."""

    joint: int


@dataclass(frozen=True)
class AtJoints:
    """Place at two joints, by their indices."""

    first: int
    second: int


@dataclass(frozen=True)
class OnRobot:
    """Place on the whole robot."""


@dataclass(frozen=True)
class OnLink:
    """Place on an identified link, by its index among these; ``joint`` moves it (None for a base)."""

    link: int
    joint: int | None


@dataclass(frozen=True)
class AtSensor:
    """Place at a wrench sensor, by its topic, or on a floating base: its axes are these ``channels`` of the measurement
    model (indices)."""

    topic: str
    channels: tuple[int, ...]


Place: TypeAlias = AtJoint | AtJoints | OnRobot | OnLink | AtSensor


def joints_of(place: Place) -> tuple[int, ...]:
    """Return the joints of a place: none for the whole robot and for sensors."""
    match place:
        case AtJoint(joint):
            return (joint,)
        case AtJoints(first, second):
            return (first, second)
        case OnLink(_, joint):
            return () if joint is None else (joint,)
    return ()


def place_named(kind: PlaceKind, name: str, joints: Sequence[str]) -> Place | None:
    """Return the place with a ``name`` as in files, for effects of ``joints`` or of the whole robot; None if there is
    none."""
    if kind == "joint" and name in joints:
        return AtJoint(joints.index(name))
    pairs = ((a, b) for a in range(len(joints)) for b in range(len(joints)) if a != b)
    if kind == "joints":
        return next((AtJoints(a, b) for a, b in pairs if pair_name(joints[a], joints[b]) == name), None)
    return OnRobot() if kind in ("robot", "commands") else None


def pair_name(first: str, second: str) -> str:
    """Return the name of a place at two joints in files and tables."""
    return f"{first}+{second}"


def joint_of(place: Place) -> int:
    """Return the joint of a place at one joint."""
    (joint,) = joints_of(place)
    return joint


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One joint's motion: position, velocity and acceleration ``(3, ...)`` in rad, rad/s, rad/s^2 (or m, m/s, m/s^2);
    and ``past``: states of effects that depend on the past motion, by effect, where known."""

    states: FloatArray
    past: Mapping[Any, FloatArray] = field(default_factory=dict)

    @property
    def position(self) -> FloatArray:
        """Position ``(...)`` [rad or m]."""
        return np.asarray(self.states[0])

    @property
    def velocity(self) -> FloatArray:
        """Velocity ``(...)`` [rad/s or m/s]."""
        return np.asarray(self.states[1])

    @property
    def acceleration(self) -> FloatArray:
        """Acceleration ``(...)`` [rad/s^2 or m/s^2]."""
        return np.asarray(self.states[2])


class Motion(JointMotion):
    """Motion of all J joints ``(3, ..., J)``, in the form of :class:`JointMotion`."""

    @cached_property
    def joints(self) -> Sequence[JointMotion]:
        """Motion of each joint."""
        return [
            JointMotion(self.states[..., joint], {effect: state[..., joint] for effect, state in self.past.items()})
            for joint in range(self.states.shape[-1])
        ]


OfLoad: TypeAlias = Callable[[FloatArray, float], FloatArray]
"""Function of a recording's gear loads ``(n, J)``, sampled with a period [s]; returns ``(n, J, K)``."""
Derivatives: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Values and their first and second time derivatives, filtered like the samples, each ``(N, J, K)``."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of C channels for N samples: by the links' motion ``(N, C, J)``, and by gravity in the base frame
    ``(N, C, 3)``."""

    by_position: FloatArray
    by_velocity: FloatArray
    by_acceleration: FloatArray
    by_gravity: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Situation(Sensitivity):
    """State of a model for N samples, J joints and C channels; the first J channels are the joint efforts.

    Attributes:
        sign: direction of motion ``(N, J)``.
        predicted: predicted channels, effects included ``(N, C)``.
        load, load_rate, load_acceleration: efforts that move the rigid bodies, and their time derivatives ``(N, J)``.
        transmitted: gear loads ``(N, J)``: efforts of the rigid bodies and, for standing legs, of the ground.
        gravity: gravity in the frame of a level base ``(3,)`` [m/s^2].
        coefficients: coefficients of the model's effects, by the effect's name and place.
        from_load_history: applies a function to the load's history; returns its :data:`Derivatives` at the N samples.
    """

    sign: FloatArray
    predicted: FloatArray
    load: FloatArray
    load_rate: FloatArray
    load_acceleration: FloatArray
    transmitted: FloatArray
    gravity: FloatArray
    coefficients: Mapping[tuple[str, Place], FloatArray]
    from_load_history: Callable[[OfLoad], Derivatives]

    def column_of(self, joints: int | slice, efforts: FloatArray) -> FloatArray:
        """Return a column ``(N, C, 1)`` with ``efforts`` at these joints and zero elsewhere."""
        column = np.zeros((*self.predicted.shape, 1))
        column[:, joints, 0] = efforts
        return column

    def lag_column(self, joint: int, moved: FloatArray, rate: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return the column ``(N, C, 1)`` of a link that lags its joint's measured position by ``moved (N,)``, with
        the time derivatives ``rate`` and ``acceleration`` of that lag."""
        return -(
            self.by_position[:, :, joint, None] * moved[:, None, None]
            + self.by_velocity[:, :, joint, None] * rate[:, None, None]
            + self.by_acceleration[:, :, joint, None] * acceleration[:, None, None]
        )

    def typical_load(self, place: Place) -> float:
        """Return the std of the rigid-body load of a place's (first) joint [N m or N]; 0 without a joint."""
        return float(np.std(self.load[:, joints_of(place)[0]])) if joints_of(place) else 0.0
