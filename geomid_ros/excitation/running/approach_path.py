"""Whether a robot can go from where it is to the start of a motion, and through the motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.excitation.clearance import Distances, clearances_from, overlap
from geomid_ros.excitation.limits import TRIED
from geomid_ros.excitation.trajectory import Trajectory
from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import WIDEST
from geomid_ros.types import FloatArray

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
        self._inertias = np.array([body.parameters for body in robot.bodies])
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
        robot, still = self._robot, np.zeros((len(positions), self._robot.coupling.shape[0]))
        rows = robot.joint_effort_rows(robot.pinocchio_positions(self.whole(positions)), still, still)
        shares = np.max(np.abs(np.einsum("njbk,bk->nj", rows, self._inertias)), axis=0) / robot.effort_limits
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
