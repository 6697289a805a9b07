"""The slow way to the start of a motion and whether a robot can go it; the way from a motion to rest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.excitation.feasibility import Distances, clearances_from, overlap
from geomid_ros.excitation.limits import TRIED
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import WIDEST
from geomid_ros.types import FloatArray

_SHARE, _FASTEST = 0.1, 0.25  # of the limit of speed, and [rad/s, m/s]
_SHORTEST_WAY = 2.0  # [s]
_SHORTEST_STOP, _LONGEST_STOP = 0.3, 0.5  # [s], the latter from the limit of speed
_POINTS = 20.0  # a second
_PEAK = 15.0 / 8.0  # of the speed of a quintic from rest to rest, as a multiple of its mean


def way_by(joints: tuple[str, ...], postures: Sequence[FloatArray], speed_limits: FloatArray) -> Trajectory:
    """From rest to rest by a quintic, from each posture to the next, no joint faster than a tenth of its limit or
    0.25 rad/s (m/s).

    Args:
        joints: names.
        postures: two or more positions ``(joints,)``.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    way, *others = (_way_to(joints, *ends, speed_limits) for ends in pairwise(postures))
    for other in others:
        way = way.followed_by(other)
    return way


def _way_to(joints: tuple[str, ...], here: FloatArray, there: FloatArray, speed_limits: FloatArray) -> Trajectory:
    slow = np.minimum(_SHARE * speed_limits, _FASTEST)
    duration = max(_SHORTEST_WAY, float(np.max(_PEAK * np.abs(there - here) / slow)))
    times = np.linspace(0.0, duration, round(duration * _POINTS) + 1)
    rest = np.zeros((2, len(joints)))
    ends = Trajectory(joints, times[[0, -1]], np.array([here, there]), rest, rest)
    return Trajectory(joints, times, *ends.states(times)[:3])


def stopping_accelerations(motion: Trajectory, speed_limits: FloatArray) -> FloatArray:
    """The accelerations by which joints are stopped ``(joints,)`` [rad/s^2, m/s^2]: the largest of the motion, or more
    where a joint needs it to come from its limit of speed to rest in half a second.

    Args:
        motion: at full speed, where it is feasible.
        speed_limits: ``(joints,)``, infinite where there is none.
    """
    enough = np.where(np.isfinite(speed_limits), speed_limits / _LONGEST_STOP, 0.0)
    return np.asarray(np.maximum(np.max(np.abs(motion.accelerations), axis=0), enough))


def way_to_rest(
    joints: tuple[str, ...], position: FloatArray, velocity: FloatArray, accelerations: FloatArray
) -> Trajectory:
    """One point, at which all joints have come to rest.

    A controller that leads there from where it is by a cubic, as it does where no accelerations are given, decelerates
    uniformly: a joint at speed ``v`` that stands after ``T`` has gone ``v T / 2``.

    Args:
        joints: names.
        position, velocity: ``(joints,)``.
        accelerations: ``(joints,)``, with which the joints may be stopped; a joint with zero is taken to stand.
    """
    moving = accelerations > 0.0
    duration = max(_SHORTEST_STOP, float(np.max(np.abs(velocity[moving]) / accelerations[moving], initial=0.0)))
    end = position + np.where(moving, velocity, 0.0) * duration / 2.0
    return Trajectory(joints, np.array([duration]), end[None], np.zeros((1, len(joints))), np.zeros((1, 0)))


_INSTANTS = 50  # of a straight way at which the effort against gravity is looked at


class Passage:
    """Ways of some joints of a robot, straight in the joints' positions, while the others stand."""

    def __init__(
        self, robot: Robot, joints: Sequence[str], standing: FloatArray, collision: CollisionModel | None = None
    ) -> None:
        """
        Args:
            robot: the whole of it.
            joints: that move, in the order of all arrays here.
            standing: positions of all of the robot's joints.
            collision: what must not touch; None if nobody looks.
        """
        self._robot, self._standing, self._collision = robot, standing, collision
        self._places = [robot.joint_names.index(name) for name in joints]
        self._low, self._high = robot.position_limits[self._places].T
        self._clearances = np.zeros(0)

    def keep(self, ends: FloatArray, clearance: float) -> None:
        """Keep a ``clearance`` [m] from now on, or half of what pairs have at ``ends (N, joints)``, where they may be
        closer."""
        if self._collision is not None:
            self._clearances = clearances_from(self._collision, self.whole(ends), clearance)

    def overlap(self, position: FloatArray) -> str:
        """Which pair overlaps at a position ``(joints,)``, in words; empty if none does."""
        return "" if self._collision is None else overlap(self._collision, self.whole(position[None])[0])

    def check(self, motion: Trajectory, source: str) -> None:
        """Refuse a motion that comes too close to something. Raises InputError naming ``source``."""
        if self._collision is None:
            return

        def path(times: FloatArray) -> FloatArray:
            return self._states(motion.states(times))

        found = Distances(path, motion.duration, self._collision, self._clearances)
        if not found.settle():
            raise InputError(f"{source}: {_said(*found.worst)}, {found.worst[2]:.2f} s after the motion's start")

    def to(self, here: FloatArray, there: FloatArray) -> list[FloatArray]:
        """Postures to go by from ``here`` to ``there (joints,)``, which is the last: straight, or by one other.

        Raises InputError naming what is in the way.
        """
        if not (obstacle := self._obstacle(here, there)):
            return [there]
        low, high = np.maximum(self._low, -WIDEST), np.minimum(self._high, WIDEST)
        tried = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
        tried = tried[np.argsort(np.max(np.abs(tried - here), axis=1) + np.max(np.abs(tried - there), axis=1))]
        for posture in tried:
            if not self._obstacle(here, posture) and not self._obstacle(posture, there):
                return [posture, there]
        raise InputError(
            f"the approach to the start is not free: {obstacle}; move the robot closer to the start by hand"
        )

    def _obstacle(self, here: FloatArray, there: FloatArray) -> str:
        """What is in the straight way, in words; empty if nothing is."""
        shares = np.linspace(0.0, 1.0, _INSTANTS)[:, None]
        return self._too_heavy(here + shares * (there - here)) or self._too_close(here, there)

    def _too_heavy(self, positions: FloatArray) -> str:
        """Which joint cannot hold itself, with the URDF's inertias, at some positions ``(N, joints)``."""
        robot, whole = self._robot, self.whole(positions)
        efforts = robot.joint_efforts(*robot.moved(np.array([whole, 0.0 * whole, 0.0 * whole])))
        shares = np.max(np.abs(efforts), axis=0) / robot.effort_limits
        worst = int(np.argmax(shares))
        name = robot.joint_names[worst]
        return f"gravity takes {shares[worst]:.0%} of the effort limit of joint '{name}'" if shares[worst] > 1.0 else ""

    def _too_close(self, here: FloatArray, there: FloatArray) -> str:
        if self._collision is None:
            return ""

        def line(times: FloatArray) -> FloatArray:
            states = np.zeros((4, len(times), len(here)))
            states[0], states[1] = here + times[:, None] * (there - here), there - here
            return self._states(states)

        found = Distances(line, 1.0, self._collision, self._clearances)
        return "" if found.settle() else _said(*found.worst)

    def _states(self, states: FloatArray) -> FloatArray:
        """Those of all joints ``(4, N, all)``."""
        whole = np.zeros((*states.shape[:2], len(self._standing)))
        whole[0] = self._standing
        whole[..., self._places] = states
        return whole

    def whole(self, positions: FloatArray) -> FloatArray:
        """Positions of all joints ``(N, all)``, of those that move ``(N, joints)``."""
        whole = np.tile(self._standing, (len(positions), 1))
        whole[:, self._places] = positions
        return whole


def _said(pair: Pair, distance: float, _time: float) -> str:
    return f"{pair} come as close as {1e3 * distance:.0f} mm" if distance > 0.0 else f"{pair} collide"
