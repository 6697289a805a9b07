"""Slow approach to the start of a motion, with its checks, and the stop that brings a moving robot to rest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.excitation.feasibility import Course, PathClearance, clearances_from, overlap
from geomid_ros.excitation.limits import RANDOM_POSTURES
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.collision import CollisionModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import UNLIMITED_RANGE
from geomid_ros.types import FloatArray

_SHARE, _FASTEST = 0.1, 0.25  # largest speed: fraction of the speed limit, and [rad/s, m/s]
_SHORTEST_WAY = 2.0  # [s]
_SHORTEST_STOP, _LONGEST_STOP = 0.3, 0.5  # [s], the latter from the speed limit
_POINTS = 20.0  # per second
_PEAK = 15.0 / 8.0  # peak speed over mean speed, of a quintic from rest to rest


def trajectory_through(joints: tuple[str, ...], postures: Sequence[FloatArray], speed_limits: FloatArray) -> Trajectory:
    """Trajectory through postures, by a quintic from rest to rest between each two. No joint is faster than a tenth of
    its limit or 0.25 rad/s (m/s).

    Args:
        joints: names.
        postures: two or more positions ``(joints,)``.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    trajectory, *segments = (_way_to(joints, *ends, speed_limits) for ends in pairwise(postures))
    for segment in segments:
        trajectory = trajectory.followed_by(segment)
    return trajectory


def _way_to(joints: tuple[str, ...], start: FloatArray, goal: FloatArray, speed_limits: FloatArray) -> Trajectory:
    speeds = np.minimum(_SHARE * speed_limits, _FASTEST)
    duration = max(_SHORTEST_WAY, float(np.max(_PEAK * np.abs(goal - start) / speeds)))
    times = np.linspace(0.0, duration, round(duration * _POINTS) + 1)
    rest = np.zeros((2, len(joints)))
    ends = Trajectory(joints, times[[0, -1]], np.array([start, goal]), rest, rest)
    return Trajectory(joints, times, *ends.states(times)[:3])


def stopping_accelerations(motion: Trajectory, speed_limits: FloatArray) -> FloatArray:
    """Decelerations for stopping each joint ``(joints,)`` [rad/s^2, m/s^2]: the largest acceleration of the motion, or
    more where a joint needs it to stop from its speed limit in half a second.

    Args:
        motion: at full speed, where it is feasible.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    needed = np.where(np.isfinite(speed_limits), speed_limits / _LONGEST_STOP, 0.0)
    return np.asarray(np.maximum(np.max(np.abs(motion.accelerations), axis=0), needed))


def stopping_trajectory(
    joints: tuple[str, ...], position: FloatArray, velocity: FloatArray, accelerations: FloatArray
) -> Trajectory:
    """Trajectory of one point, at which all joints have come to rest.

    Without accelerations, a controller interpolates from its present state by a cubic. It then decelerates uniformly: a
    joint at speed ``v`` that is at rest after ``T`` has gone ``v T / 2``.

    Args:
        joints: names.
        position, velocity: ``(joints,)``.
        accelerations: ``(joints,)``, for stopping the joints; a joint with zero is assumed to be at rest.
    """
    moving = accelerations > 0.0
    duration = max(_SHORTEST_STOP, float(np.max(np.abs(velocity[moving]) / accelerations[moving], initial=0.0)))
    end = position + np.where(moving, velocity, 0.0) * duration / 2.0
    return Trajectory(joints, np.array([duration]), end[None], np.zeros((1, len(joints))), np.zeros((1, 0)))


_INSTANTS = 50  # samples of a straight path at which the effort against gravity is checked


class ApproachPath:
    """Straight joint-space paths of some joints of a robot, while its other joints are at rest."""

    def __init__(
        self, robot: Robot, joints: Sequence[str], rest_positions: FloatArray, collision: CollisionModel | None = None
    ) -> None:
        """
        Args:
            robot: with all its joints.
            joints: the moving joints, in the order of all arrays of this class.
            rest_positions: positions of all joints of the robot.
            collision: bodies that must not touch; None if they are not checked.
        """
        self._robot, self._standing, self._collision = robot, rest_positions, collision
        self._places = [robot.joint_names.index(name) for name in joints]
        self._low, self._high = robot.position_limits[self._places].T
        self._clearances = np.zeros(0)

    def require_clearance(self, ends: FloatArray, clearance: float) -> None:
        """Require a ``clearance`` [m] from now on, or half of a pair's distance at ``ends (N, joints)`` where that is
        less."""
        if self._collision is not None:
            self._clearances = clearances_from(self._collision, self.all_positions(ends), clearance)

    def overlap(self, position: FloatArray) -> str:
        """Describe the pair that overlaps most at a position ``(joints,)``; empty if none does."""
        return "" if self._collision is None else overlap(self._collision, self.all_positions(position[None])[0])

    def check(self, motion: Trajectory, source: str) -> None:
        """Refuse a motion on which bodies come too close. Raises InputError naming ``source``."""
        contact, time = self._contact(motion.states, motion.duration)
        if contact:
            raise InputError(f"{source}: {contact}, {time:.2f} s after the motion's start")

    def find_postures(self, start: FloatArray, goal: FloatArray) -> list[FloatArray]:
        """Find postures to pass from ``start`` to ``goal (joints,)``, which is the last: none or one in between.

        Raises InputError naming the obstacle.
        """
        if not (obstacle := self._obstacle(start, goal)):
            return [goal]
        low, high = np.maximum(self._low, -UNLIMITED_RANGE), np.minimum(self._high, UNLIMITED_RANGE)
        vias = np.random.default_rng(0).uniform(low, high, (RANDOM_POSTURES, len(low)))
        vias = vias[np.argsort(np.max(np.abs(vias - start), axis=1) + np.max(np.abs(vias - goal), axis=1))]
        for posture in vias:
            if not self._obstacle(start, posture) and not self._obstacle(posture, goal):
                return [posture, goal]
        raise InputError(
            f"no collision-free approach to the start: {obstacle}; move the robot closer to the start by hand"
        )

    def _obstacle(self, start: FloatArray, goal: FloatArray) -> str:
        """Describe the obstacle on the straight path; empty if there is none."""

        def line(times: FloatArray) -> FloatArray:
            states = np.zeros((4, len(times), len(start)))
            states[0], states[1] = start + times[:, None] * (goal - start), goal - start
            return states

        return self._too_heavy(line(np.linspace(0.0, 1.0, _INSTANTS))[0]) or self._contact(line, 1.0)[0]

    def _too_heavy(self, positions: FloatArray) -> str:
        """Describe a joint too weak for gravity at ``positions (N, joints)``, by the URDF's inertias; empty if none."""
        robot, all_positions = self._robot, self.all_positions(positions)
        efforts = robot.joint_efforts(*robot.moved(np.array([all_positions, 0.0 * all_positions, 0.0 * all_positions])))
        loads = np.max(np.abs(efforts), axis=0) / robot.effort_limits
        worst = int(np.argmax(loads))
        name = robot.joint_names[worst]
        return (
            f"gravity requires {loads[worst]:.0%} of the effort limit of joint '{name}'" if loads[worst] > 1.0 else ""
        )

    def _contact(self, moving: Course, duration: float) -> tuple[str, float]:
        """Describe the pair that comes closest on a path of the ``moving`` joints, if too close, and give the time [s];
        else empty, and zero."""
        if self._collision is None:
            return "", 0.0
        clearance = PathClearance(
            lambda times: self._states(moving(times)), duration, self._collision, self._clearances
        )
        if clearance.verify():
            return "", 0.0
        pair, distance, time = clearance.worst
        return f"{pair} come as close as {1e3 * distance:.0f} mm" if distance > 0.0 else f"{pair} collide", time

    def _states(self, moving: FloatArray) -> FloatArray:
        """States of all joints ``(4, N, all)``, from those of the moving ones ``(4, N, joints)``."""
        all_states = np.zeros((*moving.shape[:2], len(self._standing)))
        all_states[0] = self._standing
        all_states[..., self._places] = moving
        return all_states

    def all_positions(self, positions: FloatArray) -> FloatArray:
        """Positions of all joints ``(N, all)``, from those of the moving ones ``(N, joints)``."""
        return np.asarray(self._states(positions[None])[0])
