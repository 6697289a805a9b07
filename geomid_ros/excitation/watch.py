"""What a robot may do, by its description; whether a motion keeps to it, before it begins and while it is under way."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.robot import Robot
from geomid_ros.signals.messages import Message
from geomid_ros.types import FloatArray

_LONGEST_LOOK = 0.01  # [s]: a longer pause was one of this process, not of the robot
_WINDOW, _STEP = 0.3, 0.01  # [s] in which a joint must have moved, and between instants that are remembered
_INSTANTS = 6  # the last, whose positions say how fast a joint is that does not say so itself
_SEEN, _STILL = 0.02, 0.05  # [rad, m] that a joint should have moved; as a share of it, what counts as not at all
_SLACK = 1e-6  # of rounding, in numbers that were written to a file
_AT_REST = 1e-3  # [rad/s, m/s]
_OUTSIDE = 0.005  # [rad, m] of a range, as a joint may rest at its end


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
        """Those of a robot's URDF. Raises InputError naming the ``source`` of the joints if it has none of a name."""
        for name in joints:
            if name not in robot.joint_names:
                unknown = unknown_name(f"joint of {robot.source}", name, robot.joint_names)
                raise InputError(f"{source}: made for another robot: {unknown}")
        places = [robot.joint_names.index(name) for name in joints]
        lower, upper = robot.position_limits[places].T
        return RobotLimits(joints, lower, upper, robot.speed_limits[places], robot.effort_limits[places])

    def out_of_range(self, position: FloatArray) -> str:
        """Which joint is out of its range at a position ``(joints,)``, in a sentence, if one is."""
        for index in np.flatnonzero((position < self.lower - _OUTSIDE) | (position > self.upper + _OUTSIDE)):
            limits = f"{self.lower[index]:g} to {self.upper[index]:g}"
            return f"joint '{self.joints[index]}' is at {position[index]:.3f}, outside its range {limits}"
        return ""


def check_motion(motion: Trajectory, limits: RobotLimits, source: str) -> None:
    """Refuse a motion that a robot cannot make, or that neither begins nor ends at rest.

    Raises:
        InputError: naming ``source`` and the joint.
    """
    if not motion.accelerations.shape[1]:
        raise InputError(f"{source}: no point has accelerations; expected a motion as 'geomid excite' writes it")
    for index, when in ((0, "begins"), (-1, "ends")):
        fast = int(np.argmax(np.abs(motion.velocities[index])))
        if abs(motion.velocities[index, fast]) > _AT_REST:
            raise InputError(
                f"{source}: the motion {when} at {motion.velocities[index, fast]:.3g} rad/s (m/s) of joint "
                f"'{motion.joints[fast]}'; it must begin and end at rest"
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
    """Position, velocity and effort of the joints ``(joints,)`` at a ``stamp`` [ns]; NaN what is not measured."""

    stamp: int
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray

    @staticmethod
    def of(message: Message, joints: tuple[str, ...]) -> JointState | None:
        """That of these joints in a message, if it has all their positions."""
        if not set(joints).issubset(message.names):
            return None
        places = [message.names.index(name) for name in joints]
        absent = np.full(len(joints), np.nan)
        position, velocity, effort = (
            values[places] if len(values) == len(message.names) else absent for values in message.arrays
        )
        return JointState(message.stamp, position, velocity, effort) if np.all(np.isfinite(position)) else None


class Watch:
    """Says when a motion must be stopped, and when it is over.

    Time is that of the messages' stamps since the one at which the motion began: a simulation may be slower than the
    world.
    """

    def __init__(
        self, motion: Trajectory, limits: RobotLimits, *, tolerance: float, silence: float, begin: int
    ) -> None:
        """
        Args:
            motion: that the controller was given.
            limits: of the same joints.
            tolerance: how far a joint may be from where it should be [rad, m].
            silence: how long messages may stay away [s].
            begin: stamp of the motion's start [ns].
        """
        self._motion = motion
        self._limits = limits
        self._tolerance = tolerance
        self._silence = silence
        self._begin = self._last = begin
        self._silent = 0.0
        self._state: JointState
        self._lately: deque[tuple[float, FloatArray, FloatArray]] = deque()  # time, position, where it should be

    @property
    def elapsed(self) -> float:
        """Time since the start [s], by the last message."""
        return 1e-9 * (self._last - self._begin)

    @property
    def whereabouts(self) -> tuple[FloatArray, FloatArray]:
        """Position and velocity ``(joints,)`` now: as measured, or as they should be where nothing has come lately."""
        if not self._lately or self._silent > self._silence:
            return self._motion.at(self.elapsed + self._silent)
        (first, start, _), (last, end, _) = self._lately[-min(_INSTANTS, len(self._lately))], self._lately[-1]
        slope = (end - start) / max(last - first, _STEP)
        return self._state.position, np.where(np.isfinite(self._state.velocity), self._state.velocity, slope)

    def look(self, states: Sequence[JointState], seconds: float) -> str:
        """Look at what has come within the last ``seconds``. A message that is not newer than the last one is none.

        Returns:
            Why the robot must be stopped, or nothing.
        """
        new = [state for state in states if state.stamp > self._last]
        if not new:
            self._silent += min(seconds, _LONGEST_LOOK)
            return f"no joint states for {1e3 * self._silent:.0f} ms" if self._silent > self._silence else ""
        self._silent = 0.0
        return next(filter(None, map(self._take, new)), "")

    def _take(self, state: JointState) -> str:
        self._last, self._state = state.stamp, state
        wanted, _ = self._motion.at(self.elapsed)
        self._remember(state.position, wanted)
        return (
            self._limits.out_of_range(state.position)
            or self._too_strong(state.effort)
            or self._not_followed()
            or self._astray(state.position, wanted)
        )

    def _remember(self, position: FloatArray, wanted: FloatArray) -> None:
        if not self._lately or self.elapsed - self._lately[-1][0] >= _STEP:
            self._lately.append((self.elapsed, position, wanted))
        while self.elapsed - self._lately[0][0] > _WINDOW:
            self._lately.popleft()

    def _too_strong(self, effort: FloatArray) -> str:
        for index in np.flatnonzero(np.abs(effort) > self._limits.efforts):
            limit = self._limits.efforts[index]
            return f"the effort of joint '{self._name(index)}' is {effort[index]:.4g}, its limit {limit:g}"
        return ""

    def _astray(self, position: FloatArray, wanted: FloatArray) -> str:
        error = np.abs(position - wanted)
        worst = int(np.argmax(error))
        if error[worst] <= self._tolerance:
            return ""
        return (
            f"joint '{self._name(worst)}' is {error[worst]:.3f} rad (m) off its trajectory, at "
            f"{position[worst]:.3f} instead of {wanted[worst]:.3f}; {self._tolerance:g} are allowed (--tolerance)"
        )

    def _not_followed(self) -> str:
        """Whether no joint that should have moved has."""
        _, positions, wishes = zip(*self._lately, strict=True)
        asked, moved = np.ptp(wishes, axis=0), np.ptp(positions, axis=0)
        should = asked > _SEEN
        if not should.any() or np.any(moved[should] > _STILL * asked[should]):
            return ""
        most = int(np.argmax(asked))
        return (
            f"the controller does not follow: joint '{self._name(most)}' should have moved by {asked[most]:.3f} rad "
            f"(m) in the last {_WINDOW:g} s but stands still. Check that the controller is active and the robot is "
            f"enabled"
        )

    def _name(self, index: int | np.integer[Any]) -> str:
        return self._motion.joints[index]
