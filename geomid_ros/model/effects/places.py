"""Where an effect acts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

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
