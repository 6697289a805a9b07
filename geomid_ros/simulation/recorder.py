"""Control and integration: from set-points to what truly happened at the recorded instants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import JointLimits
from geomid_ros.simulation.motion import Motion
from geomid_ros.simulation.plant import Plant
from geomid_ros.types import FloatArray, IntArray

_STIFFNESS = 10.0  # effort limits per rad (or m) of position error


@dataclass(frozen=True, eq=False)
class Trace:
    """Samples of T instants: ``time (T,)`` [s], joints ``(T, n)``, ``wrench (T, 6)`` or ``(T, 0)`` in its frame.

    All of a row belongs to one instant: the effort is what acts at that position and velocity, and with the
    accelerations it satisfies the equation of motion exactly.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    wrench: FloatArray

    def reordered(self, order: IntArray) -> Trace:
        """The same samples with the joints in another ``order (n,)``."""
        joints = ("position", "velocity", "acceleration", "effort")
        return replace(self, **{name: getattr(self, name)[:, order] for name in joints})


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward by a model's inverse dynamics and PD feedback; set-points ``(2 S + 1, n)`` lie half a step apart."""

    setpoints: Motion
    feedforward: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    def effort(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Commanded efforts ``(n,)`` at the instant ``half_step / 2`` steps after the start."""
        wanted: FloatArray = (
            self.feedforward[half_step]
            + self.stiffness * (self.setpoints.position[half_step] - position)
            + self.damping * (self.setpoints.velocity[half_step] - velocity)
        )
        return wanted


def tuned_controller(setpoints: Motion, nominal: Plant, robot: Plant, joints: Sequence[JointLimits]) -> Controller:
    """A controller that knows the ``nominal`` model, tuned on the ``robot``.

    The gains make the loop critically damped, and a constant effort holds the robot still where it starts.
    """
    rows = zip(setpoints.position, setpoints.velocity, setpoints.acceleration, strict=True)
    feedforward = np.array([nominal.inverse_dynamics(*row) for row in rows])
    start, rest = setpoints.position[0], np.zeros(len(joints))
    feedforward += robot.inverse_dynamics(start, rest, rest) - nominal.inverse_dynamics(start, rest, rest)
    stiffness = _STIFFNESS * np.array([joint.effort for joint in joints])
    inertia = robot.joint_inertia(start)
    return Controller(setpoints, feedforward, stiffness, 2.0 * np.sqrt(stiffness * inertia))


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A robot under control, integrated in steps of ``step`` [s] by the classical Runge-Kutta method of order 4.

    The controller acts at every stage: an effort held over each step would lead the motion by half a step, and a
    set-point held over each sample would pass for damping and rotor inertia.
    """

    robot: Plant
    controller: Controller
    step: float

    @property
    def steps(self) -> int:
        """Number of steps for which there are set-points."""
        return (len(self.controller.feedforward) - 1) // 2

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Joint accelerations ``(n,)`` at the instant ``half_step / 2`` steps after the start."""
        return self.robot.acceleration(position, velocity, self.controller.effort(half_step, position, velocity))

    def advance(self, index: int, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and velocity one step after the instant ``index`` steps after the start."""
        speeds, accelerations = [velocity], [self.acceleration(2 * index, position, velocity)]
        for share, half_step in ((0.5, 2 * index + 1), (0.5, 2 * index + 1), (1.0, 2 * index + 2)):
            reached = position + share * self.step * speeds[-1]
            speeds.append(velocity + share * self.step * accelerations[-1])
            accelerations.append(self.acceleration(half_step, reached, speeds[-1]))
        return position + self.step * _weighted(speeds), velocity + self.step * _weighted(accelerations)


def _weighted(stages: list[FloatArray]) -> FloatArray:
    first, second, third, fourth = stages
    mean: FloatArray = (first + 2.0 * (second + third) + fourth) / 6.0
    return mean


def run(loop: ClosedLoop, substeps: int, progress: Callable[[float], None] | None = None) -> Trace:
    """Follow the controller's set-points from the first one and note every ``substeps``-th step."""
    position = loop.controller.setpoints.position[0]
    velocity = loop.controller.setpoints.velocity[0]
    rows = []
    for index in range(0, loop.steps + 1, substeps):
        acceleration = loop.acceleration(2 * index, position, velocity)
        rows.append((index * loop.step, position, velocity, acceleration, loop.robot.effort(), loop.robot.wrench()))
        for following in range(index, min(index + substeps, loop.steps)):
            position, velocity = loop.advance(following, position, velocity)
        if progress is not None:
            progress(index / loop.steps)
    return Trace(*(np.array(column) for column in zip(*rows, strict=True)))


def check_motion(trace: Trace, joints: Sequence[JointLimits]) -> None:
    """Refuse a run that diverged or reached the ends of the joints' ranges, whose stops nobody measures."""
    lower, upper = np.array([(joint.lower, joint.upper) for joint in joints]).T
    inside = (trace.position > lower) & (trace.position < upper)
    if not (inside.all() and np.isfinite(trace.effort).all()):
        raise InputError(
            "the robot left its joints' ranges: its drives are too weak for this motion. "
            "Lower motion_range, motion_speed or inertia_error, or lengthen motion_period."
        )
