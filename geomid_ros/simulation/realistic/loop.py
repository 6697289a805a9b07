"""Control and integration of a realistic robot."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic.robot import RealisticRobot
from geomid_ros.simulation.recorder import ControlLoop
from geomid_ros.types import FloatArray


@dataclass(eq=False)
class LoopState:
    """What a step needs beside positions and velocities: the bristles' ``bend (n,)`` [rad], the ``dry`` friction of
    steady sliding ``(n,)`` at its beginning, and the acceleration one step ``before``."""

    bend: FloatArray = field(default_factory=lambda: np.zeros(1))
    dry: FloatArray = field(default_factory=lambda: np.ones(1))
    before: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class RealisticLoop(ControlLoop):
    """A realistic robot under control, in steps with one evaluation each.

    Rigid bodies advance by the method of Beeman and Schofield, of second order. The bristles follow their own equation
    exactly, at the step's mean speed and the dry friction of its beginning: in fast sliding they settle within much
    less than a step, which no explicit method would bear.
    """

    robot: Plant
    truth: RealisticRobot
    memory: LoopState = field(default_factory=LoopState)

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        truth, memory = self.truth, self.memory
        effort = truth.motors.supplied(self.controller.effort(half_step, position, velocity))
        memory.dry = truth.dry(velocity, position, effort)
        cold = truth.warm_up.cold(0.5 * half_step * self.step)
        friction = truth.friction.force(memory.bend, velocity, memory.dry, cold)
        unseen = truth.motors.unseen(effort, position)
        return self.robot.driven_acceleration(position, velocity, effort, unseen - friction)

    def advance(
        self, _: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        memory, step = self.memory, self.step
        before = acceleration if memory.before is None else memory.before
        change = step * (1.5 * acceleration - 0.5 * before)
        moved = step * velocity + step**2 / 6.0 * (4.0 * acceleration - before)
        memory.bend = self.truth.friction.bent(memory.bend, moved / step, memory.dry, step)
        memory.before = acceleration
        return position + moved, velocity + change
