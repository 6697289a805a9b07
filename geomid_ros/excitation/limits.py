"""What a motion must not exceed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import WIDEST
from geomid_ros.types import FloatArray

STEEPEST = 10.0
"""[1/s] of acceleration to speed at most, and of jerk to acceleration, where no limits of these are given."""
_POSTURES = 300
TRIED = 100
"""Postures, at most, to begin from or to go by."""
_LEAST_SHARE = 0.1  # of the effort is left to accelerate with, wherever gravity takes more


@dataclass(frozen=True)
class JointLimits:
    """One joint's limits as a file gives them; None where it says nothing. SI units."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    effort: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionLimits:
    """Limits of J joints, each ``(J,)``: of ``position (J, 2)``, ``velocity``, ``acceleration``, ``jerk`` and
    ``effort``; ``notes``: which of them follow from others, in sentences."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    effort: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def derivatives(self) -> FloatArray:
        """Of velocity, acceleration and jerk ``(3, J)``."""
        return np.array([self.velocity, self.acceleration, self.jerk])


def motion_limits(
    robot: Robot, given: dict[str, JointLimits], inertias: FloatArray, speed: float, source: str
) -> MotionLimits:
    """All limits of a robot's joints.

    Args:
        robot: whose URDF says limits of position, velocity and effort.
        given: others by joint, which win.
        inertias: of all bodies ``(bodies, 10)``.
        speed: share of the velocity limits that may be used.
        source: names the URDF in messages.

    Raises:
        InputError: naming the joint whose limit is missing.
    """
    own = [given.get(name, JointLimits()) for name in robot.joint_names]
    position = _or_given(robot.position_limits, [(limit.lower, limit.upper) for limit in own])
    velocity = _or_given(robot.speed_limits, [limit.velocity for limit in own])
    effort = _or_given(robot.effort_limits, [limit.effort for limit in own])
    acceleration = _or_given(np.full(len(own), np.inf), [limit.acceleration for limit in own])
    jerk = _or_given(np.full(len(own), np.inf), [limit.jerk for limit in own])
    _require(robot, velocity, "velocity", source)
    derived = ~np.isfinite(acceleration)
    _require(robot, np.where(derived, effort, 0.0), "acceleration", source)
    if np.any(derived):
        by_effort = _by_effort(robot, position, effort, inertias)
        acceleration = np.where(derived, np.minimum(by_effort, STEEPEST * velocity), acceleration)
    by_jerk = ~np.isfinite(jerk)
    return MotionLimits(
        position=position,
        velocity=speed * velocity,
        acceleration=acceleration,
        jerk=np.where(by_jerk, STEEPEST * acceleration, jerk),
        effort=effort,
        notes=tuple(_notes(robot.joint_names, derived, by_jerk, acceleration)),
    )


def _or_given(known: FloatArray, given: Sequence[object]) -> FloatArray:
    """The known numbers, and those that are given in their place."""
    stated = np.array(given, dtype=np.float64)  # None is not a number
    return np.where(np.isfinite(stated), stated, known)


def _require(robot: Robot, limits: FloatArray, kind: str, source: str) -> None:
    for name, limit in zip(robot.joint_names, limits, strict=True):
        if not np.isfinite(limit):
            needed = "a velocity" if kind == "velocity" else "an effort"
            raise InputError(
                f"{source}: joint '{name}' has no {kind} limit; give it {needed} in its <limit>, or has_{kind}_limits: "
                f"true and max_{kind} in the file of --limits"
            )


def _by_effort(robot: Robot, position: FloatArray, effort: FloatArray, inertias: FloatArray) -> FloatArray:
    """The accelerations ``(J,)`` for which the efforts suffice beside gravity, each joint's by itself, in the worst of
    some postures."""
    random = np.random.default_rng(0)
    low, high = np.clip(position, -WIDEST, WIDEST).T
    postures = random.uniform(low, high, (_POSTURES, len(effort)))
    states = np.zeros((3, *postures.shape))
    states[0] = postures
    gravity, inertia = robot.joint_efforts(*robot.moved(states), inertias), np.empty(postures.shape)
    for joint in range(len(effort)):
        states[2] = np.eye(len(effort))[joint]
        inertia[:, joint] = (robot.joint_efforts(*robot.moved(states), inertias) - gravity)[:, joint]
    left = np.maximum(effort - np.abs(gravity), _LEAST_SHARE * effort)
    return np.asarray(np.min(left / np.maximum(inertia, np.finfo(float).tiny), axis=0))


def _notes(names: Sequence[str], derived: FloatArray, by_jerk: FloatArray, acceleration: FloatArray) -> list[str]:
    notes = []
    if np.any(derived):
        said = ", ".join(f"{name} {a:.3g}" for name, a, own in zip(names, acceleration, derived, strict=True) if own)
        notes.append(
            "acceleration limits are derived from the effort limits, and are at most "
            f"{STEEPEST:g} 1/s times the velocity limits [rad/s^2, m/s^2]: {said}"
        )
    if np.any(by_jerk):
        which = "all joints" if np.all(by_jerk) else ", ".join(np.array(names)[by_jerk])
        notes.append(f"jerk limits are {STEEPEST:g} 1/s times the acceleration limits: {which}")
    return notes


def starts(limits: MotionLimits) -> Iterator[FloatArray]:
    """Postures ``(J,)`` to begin from, the most obvious first: zero where that is in the middle half of a range, the
    middle of the ranges, and others at random in their middle halves."""
    low, high = limits.position.T
    wide = np.clip(low, -WIDEST, None), np.clip(high, None, WIDEST)
    middle, half = 0.5 * (wide[0] + wide[1]), 0.5 * (wide[1] - wide[0])
    inner = middle - 0.5 * half, middle + 0.5 * half
    yield np.where((inner[0] < 0.0) & (inner[1] > 0.0), 0.0, middle)
    yield middle
    random = np.random.default_rng(0)
    for _ in range(TRIED):
        yield middle + 0.5 * half * random.uniform(-1.0, 1.0, len(low))
