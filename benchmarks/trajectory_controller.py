"""A robot with a joint_trajectory_controller, simulated, to try ``geomid excite run`` on: ``--urdf ROBOT.urdf``.

It follows trajectories as ros2_control's does: a new one replaces the old one at once, and polynomials lead from where
it is to the first point and from point to point. It publishes joint states and the description. On ``~/fault`` it is
told what is to go wrong from then on.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import rclpy
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import ok, try_shutdown
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

Array = NDArray[np.float64]
SILENT, DEAF, PUSHED, STRONG, GONE = "silent", "deaf", "pushed", "strong", "gone"
"""Faults: no joint states; stands still, whatever it is told; a joint is pushed away; an effort beyond its limit; the
controller is unloaded, while joint states come."""
_PUSH = 0.6  # [rad]
_HEAVIER = 1.2  # the true inertias, as a multiple of the URDF's
_VISCOUS, _COULOMB, _NOISE = 0.3, 0.4, 0.02  # [N m s/rad], [N m], [N m]
_ACROSS = 0.02  # [rad/s] where Coulomb friction changes its sign


class Arm:
    """The efforts of a robot that moves as it is told."""

    def __init__(self, urdf: str) -> None:
        self._model = pin.buildModelFromXML(urdf)
        for index in range(1, self._model.njoints):
            body = self._model.inertias[index]
            self._model.inertias[index] = pin.Inertia(_HEAVIER * body.mass, body.lever, _HEAVIER * body.inertia)
        self._data = self._model.createData()
        self._random = np.random.default_rng(0)
        self.joints = list(self._model.names)[1:]
        self.limits = np.array(self._model.effortLimit)

    def effort(self, motion: Array) -> Array:
        """Efforts ``(joints,)`` of positions, velocities and accelerations ``(3, joints)``."""
        rigid = pin.rnea(self._model, self._data, *motion)
        friction = _VISCOUS * motion[1] + _COULOMB * np.tanh(motion[1] / _ACROSS)
        return np.asarray(rigid + friction + self._random.normal(0.0, _NOISE, len(rigid)))


def between(time: float, span: float, begin: Array, end: Array) -> Array:
    """Position, velocity and acceleration ``(3, joints)`` on the polynomial from one state to the next, ``time`` after
    the first, that lie ``span`` apart; states have two or three rows."""
    order = len(begin) + len(end)
    conditions = np.concatenate([_powers(0.0)[: len(begin), :order], _powers(span)[: len(end), :order]])
    coefficients = np.linalg.solve(conditions, np.concatenate([begin, end]))
    return np.asarray(_powers(time)[:, :order] @ coefficients)


_DERIVED = np.array([[math.perm(power, derivative) for power in range(6)] for derivative in range(3)])
_EXPONENTS = np.maximum(np.arange(6) - np.arange(3)[:, None], 0)


def _powers(at: float) -> Array:
    """Of a time the powers from 0 to 5, and their first and second derivatives ``(3, 6)``."""
    return np.asarray(_DERIVED * float(at) ** _EXPONENTS)


class Follower:
    """Follows the last trajectory that it was given."""

    def __init__(self, joints: list[str], position: Array) -> None:
        self._joints = joints
        self._hold(position)

    def _hold(self, position: Array) -> None:
        self.motion = np.vstack([position, np.zeros((2, len(position)))])
        self._times, self._states = [0.0], [self.motion]
        self._begin = 0.0

    def take(self, message: JointTrajectory, now: float) -> None:
        """Follow it from now on."""
        order = [message.joint_names.index(name) for name in self._joints]
        self._begin = now
        self._times, self._states = [0.0], [self.motion[: 3 if message.points[0].accelerations else 2]]
        for point in message.points:
            at = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            if at > 0.0:
                self._times.append(at)
                self._states.append(_rows(point)[:, order])

    def step(self, now: float) -> None:
        """Be where the trajectory is."""
        passed = now - self._begin
        after = int(np.searchsorted(self._times, passed))
        if after >= len(self._times):
            self._hold(self._states[-1][0])
        elif after > 0:
            begin, end = self._times[after - 1 : after + 1]
            self.motion = between(passed - begin, end - begin, self._states[after - 1], self._states[after])


def _rows(point: JointTrajectoryPoint) -> Array:
    return np.array([list(row) for row in (point.positions, point.velocities, point.accelerations) if row])


class TrajectoryController(Node):
    """The robot and its controller."""

    def __init__(self, urdf: str, start: float) -> None:
        """``start``: position of all joints [rad]."""
        super().__init__("joint_trajectory_controller")
        self._arm = Arm(urdf)
        self._follower = Follower(self._arm.joints, np.full(len(self._arm.joints), start))
        self._fault = ""
        self._now = 0.0  # [s] when it moved last
        self._states = self.create_publisher(JointState, "joint_states", 100)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.create_publisher(String, "robot_description", latched)
        self._description.publish(String(data=urdf))
        self._trajectories = self.create_subscription(JointTrajectory, "~/joint_trajectory", self._take, 10)
        self.create_subscription(String, "~/fault", self._on_fault, 10)

    def _take(self, message: JointTrajectory) -> None:
        self._follower.take(message, self._now)

    def _on_fault(self, message: String) -> None:
        self._fault = message.data
        if self._fault == GONE:
            self.destroy_subscription(self._trajectories)

    def step(self) -> None:
        """Move on, and publish."""
        now = self.get_clock().now()
        self._now = 1e-9 * now.nanoseconds
        if self._fault not in (DEAF, GONE):
            self._follower.step(self._now)
        motion = self._follower.motion
        if self._fault in (DEAF, GONE):
            motion = np.vstack([motion[0], np.zeros_like(motion[1:])])
        effort = self._arm.effort(motion)
        position = motion[0].copy()
        position[0] += _PUSH if self._fault == PUSHED else 0.0
        effort[0] += 2.0 * self._arm.limits[0] if self._fault == STRONG else 0.0
        message = JointState(name=self._arm.joints, position=position.tolist())
        message.velocity, message.effort = motion[1].tolist(), effort.tolist()
        message.header.stamp = now.to_msg()
        if self._fault != SILENT:
            self._states.publish(message)


def main() -> None:
    """Run until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--urdf", type=Path, required=True)
    parser.add_argument("--rate", type=float, default=250.0, help="joint states a second (%(default)g)")
    parser.add_argument("--start", type=float, default=0.0, help="position of all joints [rad] (%(default)g)")
    arguments = parser.parse_args()
    rclpy.init()
    node = TrajectoryController(arguments.urdf.read_text(encoding="utf-8"), arguments.start)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    due = time.monotonic()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        try:
            while ok():
                due = max(due + 1.0 / arguments.rate, time.monotonic())
                executor.spin_once(timeout_sec=0.0)  # trajectories are taken even where there is no time left
                while (left := due - time.monotonic()) > 0.0:
                    executor.spin_once(timeout_sec=left)
                node.step()
        except rclpy_implementation.RCLError:  # the signal came in between, and what is called says so
            if ok():
                raise
    node.destroy_node()
    try_shutdown()


if __name__ == "__main__":
    main()
