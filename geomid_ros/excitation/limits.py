"""Limits of an exciting motion: position, velocity, acceleration, jerk and effort."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import UNLIMITED_RANGE
from geomid_ros.types import FloatArray

DERIVATIVE_RATIO = 10.0
"""[1/s] Largest ratio of acceleration to speed, and of jerk to acceleration, where no such limits are given."""
_POSTURES = 300
RANDOM_POSTURES = 100
"""Maximum number of random postures tried as a start or as an intermediate posture."""
_LEAST_SHARE = 0.1  # fraction of the effort limit left for acceleration, even where gravity needs more


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint from a file, in SI units; None where it gives none."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    effort: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionLimits:
    """Limits of J joints: ``position (J, 2)``; ``velocity``, ``acceleration``, ``jerk`` and ``effort``, each ``(J,)``.
    ``notes``: sentences on limits derived from others."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    effort: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def derivatives(self) -> FloatArray:
        """Limits of velocity, acceleration and jerk ``(3, J)``."""
        return np.array([self.velocity, self.acceleration, self.jerk])


def motion_limits(
    robot: Robot, given: dict[str, JointLimits], inertias: FloatArray, speed: float, source: str
) -> MotionLimits:
    """Collect all limits of a robot's joints.

    Args:
        robot: its URDF gives limits of position, velocity and effort.
        given: limits by joint, which override those of the URDF.
        inertias: of all bodies ``(bodies, 10)``.
        speed: fraction of the velocity limits that may be used.
        source: names the URDF in messages.

    Raises:
        InputError: naming the joint whose limit is missing.
    """
    stated = np.array([astuple(given.get(name, JointLimits())) for name in robot.joint_names], dtype=np.float64)
    unlimited = np.full(len(stated), np.inf)
    urdf = np.column_stack([robot.position_limits, robot.speed_limits, unlimited, unlimited, robot.effort_limits])
    limits = np.where(np.isfinite(stated), stated, urdf)  # None has become NaN
    position, (velocity, acceleration, jerk, effort) = limits[:, :2], limits[:, 2:].T
    _require(robot, velocity, "velocity", source)
    derived = ~np.isfinite(acceleration)
    _require(robot, np.where(derived, effort, 0.0), "acceleration", source)
    if np.any(derived):
        by_effort = _by_effort(robot, position, effort, inertias)
        acceleration = np.where(derived, np.minimum(by_effort, DERIVATIVE_RATIO * velocity), acceleration)
    by_jerk = ~np.isfinite(jerk)
    return MotionLimits(
        position=position,
        velocity=speed * velocity,
        acceleration=acceleration,
        jerk=np.where(by_jerk, DERIVATIVE_RATIO * acceleration, jerk),
        effort=effort,
        notes=tuple(_notes(robot.joint_names, derived, by_jerk, acceleration)),
    )


def _require(robot: Robot, limits: FloatArray, kind: str, source: str) -> None:
    for name, limit in zip(robot.joint_names, limits, strict=True):
        if not np.isfinite(limit):
            needed = "a velocity" if kind == "velocity" else "an effort"
            raise InputError(
                f"{source}: joint '{name}' has no {kind} limit; give it {needed} in its <limit>, or has_{kind}_limits: "
                f"true and max_{kind} in the file of --limits"
            )


def _by_effort(robot: Robot, position: FloatArray, effort: FloatArray, inertias: FloatArray) -> FloatArray:
    """Accelerations ``(J,)`` that the efforts allow in addition to gravity, in the worst of random postures. Each joint
    accelerates alone."""
    random = np.random.default_rng(0)
    low, high = np.clip(position, -UNLIMITED_RANGE, UNLIMITED_RANGE).T
    postures = random.uniform(low, high, (_POSTURES, len(effort)))
    states = np.zeros((3, *postures.shape))
    states[0] = postures
    gravity, inertia = robot.joint_efforts(*robot.moved(states), inertias), np.empty(postures.shape)
    for joint in range(len(effort)):
        states[2] = np.eye(len(effort))[joint]
        inertia[:, joint] = (robot.joint_efforts(*robot.moved(states), inertias) - gravity)[:, joint]
    available = np.maximum(effort - np.abs(gravity), _LEAST_SHARE * effort)
    return np.asarray(np.min(available / np.maximum(inertia, np.finfo(float).tiny), axis=0))


def _notes(names: Sequence[str], derived: FloatArray, by_jerk: FloatArray, acceleration: FloatArray) -> list[str]:
    notes = []
    if np.any(derived):
        text = ", ".join(f"{name} {a:.3g}" for name, a, mask in zip(names, acceleration, derived, strict=True) if mask)
        notes.append(
            "acceleration limits are derived from the effort limits, and are at most "
            f"{DERIVATIVE_RATIO:g} 1/s times the velocity limits [rad/s^2, m/s^2]: {text}"
        )
    if np.any(by_jerk):
        joints = "all joints" if np.all(by_jerk) else ", ".join(np.array(names)[by_jerk])
        notes.append(f"jerk limits are {DERIVATIVE_RATIO:g} 1/s times the acceleration limits: {joints}")
    return notes


def start_postures(limits: MotionLimits) -> Iterator[FloatArray]:
    """Yield start postures ``(J,)``, the most obvious first: zero where it is in the middle half of a range (else the
    middle), the middle of all ranges, and random ones in the middle halves."""
    low, high = limits.position.T
    finite = np.clip(low, -UNLIMITED_RANGE, None), np.clip(high, None, UNLIMITED_RANGE)
    middle, half = 0.5 * (finite[0] + finite[1]), 0.5 * (finite[1] - finite[0])
    inner = middle - 0.5 * half, middle + 0.5 * half
    yield np.where((inner[0] < 0.0) & (inner[1] > 0.0), 0.0, middle)
    yield middle
    random = np.random.default_rng(0)
    for _ in range(RANDOM_POSTURES):
        yield middle + 0.5 * half * random.uniform(-1.0, 1.0, len(low))
