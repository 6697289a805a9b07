"""Limits of motions: of joints and robots, and whether a motion keeps them, before it begins and while it runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import REST_SPEED, UNLIMITED_RANGE
from geomid_ros.signals.messages import Message
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


_LONGEST_LOOK = 0.01  # [s]: a longer pause is attributed to this process, not to the robot
_WINDOW, _STEP = 0.3, 0.01  # [s] window in which a joint must move, and the interval of remembered states
_INSTANTS = 6  # last states, whose positions give the speed of a joint that publishes none
_SEEN, _STILL = 0.02, 0.05  # [rad, m] commanded motion to check a joint; fraction of it below which it does not follow
_SLACK = 1e-6  # rounding of numbers in a file
_OUTSIDE = 0.005  # [rad, m] allowed outside a range, as a joint may rest at its end


@dataclass(frozen=True, eq=False)
class RobotLimits:
    """Limits of ``joints``, each ``(joints,)``, infinite where there is none.

    ``lower`` and ``upper`` [rad, m], ``speeds`` [rad/s, m/s], ``efforts`` [N m, N].
    """

    joints: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    speeds: FloatArray
    efforts: FloatArray

    @staticmethod
    def of(robot: Robot, joints: tuple[str, ...], source: str) -> RobotLimits:
        """Limits in a robot's URDF. Raises InputError naming the ``source`` of the joints if it lacks one of them."""
        for name in joints:
            if name not in robot.joint_names:
                unknown = unknown_name(f"joint of {robot.source}", name, robot.joint_names)
                raise InputError(f"{source}: the motion belongs to another robot: {unknown}")
        places = [robot.joint_names.index(name) for name in joints]
        lower, upper = robot.position_limits[places].T
        return RobotLimits(joints, lower, upper, robot.speed_limits[places], robot.effort_limits[places])

    def out_of_range(self, position: FloatArray) -> str:
        """Describe the first joint that is out of its range at a position ``(joints,)``; empty if none is."""
        for index in np.flatnonzero((position < self.lower - _OUTSIDE) | (position > self.upper + _OUTSIDE)):
            limits = f"{self.lower[index]:g} to {self.upper[index]:g}"
            return f"joint '{self.joints[index]}' is at {position[index]:.3f}, outside its range {limits}"
        return ""


def check_motion(motion: Trajectory, limits: RobotLimits, source: str) -> None:
    """Refuse a motion that exceeds a robot's limits, or that does not begin and end at rest.

    Raises:
        InputError: naming ``source`` and the joint.
    """
    if not motion.accelerations.shape[1]:
        raise InputError(f"{source}: no point has accelerations; expected a motion as 'geomid excite' writes it")
    for index, when in ((0, "begins"), (-1, "ends")):
        fastest = int(np.argmax(np.abs(motion.velocities[index])))
        if abs(motion.velocities[index, fastest]) > REST_SPEED:
            raise InputError(
                f"{source}: the motion {when} at {motion.velocities[index, fastest]:.3g} rad/s (m/s) of joint "
                f"'{motion.joints[fastest]}'; it must begin and end at rest"
            )
    lowest, highest = motion.positions.min(axis=0), motion.positions.max(axis=0)
    for index, joint in enumerate(motion.joints):
        if lowest[index] < limits.lower[index] - _SLACK or highest[index] > limits.upper[index] + _SLACK:
            raise InputError(
                f"{source}: joint '{joint}' moves from {lowest[index]:.3f} to {highest[index]:.3f}, outside its range "
                f"{limits.lower[index]:g} to {limits.upper[index]:g} in the URDF"
            )
        if motion.speeds[index] > limits.speeds[index] * (1.0 + _SLACK):
            raise InputError(
                f"{source}: joint '{joint}' moves at {motion.speeds[index]:.3g}, faster than {limits.speeds[index]:g} "
                "in the URDF; lower --speed"
            )


@dataclass(frozen=True, eq=False)
class JointState:
    """Position, velocity and effort of the joints ``(joints,)`` at a ``stamp`` [ns]; NaN if not measured."""

    stamp: int
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray

    @staticmethod
    def of(message: Message, joints: tuple[str, ...]) -> JointState | None:
        """State of these joints in a message; None if it lacks one of their positions."""
        if not set(joints).issubset(message.names):
            return None
        places = [message.names.index(name) for name in joints]
        absent = np.full(len(joints), np.nan)
        position, velocity, effort = (
            values[places] if len(values) == len(message.names) else absent for values in message.arrays
        )
        return JointState(message.stamp, position, velocity, effort) if np.all(np.isfinite(position)) else None


class MotionMonitor:
    """Monitor of a running motion: reports why it must be stopped.

    Time is that of the messages' stamps since the motion's start, because a simulation may be slower than real time.
    """

    def __init__(
        self, motion: Trajectory, limits: RobotLimits, *, tolerance: float, silence: float, begin: int
    ) -> None:
        """
        Args:
            motion: the trajectory that the controller was given.
            limits: of the same joints.
            tolerance: largest tracking error of a joint [rad, m].
            silence: longest time without a message [s].
            begin: stamp of the motion's start [ns].
        """
        self._motion = motion
        self._limits = limits
        self._tolerance = tolerance
        self._silence = silence
        self._begin = self._last = begin
        self._silent = 0.0
        self._state: JointState
        self._lately: deque[tuple[float, FloatArray, FloatArray]] = deque()  # time, position, commanded position

    @property
    def elapsed(self) -> float:
        """Time since the start [s], by the last message."""
        return 1e-9 * (self._last - self._begin)

    @property
    def present_state(self) -> tuple[FloatArray, FloatArray]:
        """Present position and velocity ``(joints,)``: as measured, or as commanded after too long a silence."""
        if not self._lately or self._silent > self._silence:
            return self._motion.at(self.elapsed + self._silent)
        (first, start, _), (last, end, _) = self._lately[-min(_INSTANTS, len(self._lately))], self._lately[-1]
        slope = (end - start) / max(last - first, _STEP)
        return self._state.position, np.where(np.isfinite(self._state.velocity), self._state.velocity, slope)

    def check(self, states: Sequence[JointState], seconds: float) -> str:
        """Check the states received within the last ``seconds``. States not newer than the last one are ignored.

        Returns:
            Reason to stop the robot, or an empty string.
        """
        newer = [state for state in states if state.stamp > self._last]
        if not newer:
            self._silent += min(seconds, _LONGEST_LOOK)
            return f"no joint states for {1e3 * self._silent:.0f} ms" if self._silent > self._silence else ""
        self._silent = 0.0
        return next(filter(None, map(self._take, newer)), "")

    def _take(self, state: JointState) -> str:
        self._last, self._state = state.stamp, state
        commanded, _ = self._motion.at(self.elapsed)
        self._remember(state.position, commanded)
        return (
            self._limits.out_of_range(state.position)
            or self._too_strong(state.effort)
            or self._not_followed()
            or self._astray(state.position, commanded)
        )

    def _remember(self, position: FloatArray, commanded: FloatArray) -> None:
        if not self._lately or self.elapsed - self._lately[-1][0] >= _STEP:
            self._lately.append((self.elapsed, position, commanded))
        while self.elapsed - self._lately[0][0] > _WINDOW:
            self._lately.popleft()

    def _too_strong(self, effort: FloatArray) -> str:
        for index in np.flatnonzero(np.abs(effort) > self._limits.efforts):
            limit = self._limits.efforts[index]
            return f"the effort of joint '{self._motion.joints[index]}' is {effort[index]:.4g}, its limit {limit:g}"
        return ""

    def _astray(self, position: FloatArray, commanded: FloatArray) -> str:
        error = np.abs(position - commanded)
        worst = int(np.argmax(error))
        if error[worst] <= self._tolerance:
            return ""
        return (
            f"joint '{self._motion.joints[worst]}' is {error[worst]:.3f} rad (m) off its trajectory, at "
            f"{position[worst]:.3f} instead of {commanded[worst]:.3f}; tolerance {self._tolerance:g} (--tolerance)"
        )

    def _not_followed(self) -> str:
        """Reason to stop if no joint follows its commanded motion in the window; else empty."""
        _, positions, commands = zip(*self._lately, strict=True)
        span, moved = np.ptp(commands, axis=0), np.ptp(positions, axis=0)
        should = span > _SEEN
        if not should.any() or np.any(moved[should] > _STILL * span[should]):
            return ""
        worst = int(np.argmax(span))
        return (
            f"the controller does not follow: joint '{self._motion.joints[worst]}' was commanded to move by "
            f"{span[worst]:.3f} rad (m) in the last {_WINDOW:g} s but is at rest. Check that the controller is active "
            "and the robot is enabled"
        )
