"""The robot as it truly is: its control, its true motion at the recorded instants, and what sensors make of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import Description, LinkInertia, UrdfLimits, perturbed, read_description
from geomid_ros.simulation.effects.choice import chosen_effects
from geomid_ros.simulation.effects.physics import TrueEffect, sensed
from geomid_ros.simulation.motion import RunTrace, SetPoints
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant, Simulator
from geomid_ros.simulation.robots import robot_description
from geomid_ros.types import FloatArray, IntArray

_STIFFNESS = 10.0  # effort limits per rad (or m) of position error
_STABLE = 0.8  # decay per step of a joint alone by the controller's damping; all together, Runge-Kutta bears 2.8
_LOST = 0.3  # rad or m from the set-point
_LOOK = 0.05  # s between the set-points at which that is looked at


@dataclass(frozen=True, eq=False)
class JointController:
    """Feed-forward by a model's inverse dynamics and PD feedback; set-points ``(2 S + 1, n)`` lie half a step apart."""

    setpoints: SetPoints
    feedforward: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    def effort(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Commanded efforts ``(n,)`` at the instant ``half_step / 2`` steps after the start."""
        return np.asarray(
            self.feedforward[half_step]
            + self.stiffness * (self.setpoints.position[half_step] - position)
            + self.damping * (self.setpoints.velocity[half_step] - velocity)
        )

    def slowed(self, robot: Simulator, step: float) -> JointController:
        """With less damping, where the ``robot`` would answer faster than steps of ``step`` [s] can follow.

        A joint that moves alone, the others free, feels the inertia ``1 / (M^-1)_jj``: that of a light rotor before a
        gear that gives, or little where the axes of two joints are nearly one line.
        """
        positions = self.setpoints.position[:: max(1, round(_LOOK / step))]
        inverses = (np.linalg.inv(robot.inertia_matrix(robot.at_rest(position)[0])) for position in positions)
        lightest = 1.0 / np.max([np.diag(inverse)[robot.driven] for inverse in inverses], axis=0)
        return replace(self, damping=np.minimum(self.damping, _STABLE * lightest / step))


def tuned_controller(
    setpoints: SetPoints, nominal: Simulator, robot: Simulator, joints: Sequence[UrdfLimits], tuned_on: Simulator
) -> JointController:
    """A controller that knows the ``nominal`` model, its gains ``tuned_on`` that or the ``robot``.

    They make the loop critically damped where it starts, and a constant effort holds the robot still there.
    """
    rows = zip(setpoints.position, setpoints.velocity, setpoints.acceleration, strict=True)
    feedforward = np.array([nominal.inverse_dynamics(*row) for row in rows])
    start, rest = robot.at_rest(setpoints.position[0])
    feedforward += robot.inverse_dynamics(start, rest, rest)[robot.driven] - feedforward[0]
    stiffness = _STIFFNESS * np.array([joint.effort for joint in joints])
    inertia = tuned_on.inertia_matrix(tuned_on.at_rest(setpoints.position[0])[0])
    return JointController(
        setpoints, feedforward, stiffness, 2.0 * np.sqrt(stiffness * np.diag(inertia)[tuned_on.driven])
    )


@dataclass(eq=False)
class ControlLoop:
    """A robot under control, integrated in steps of ``step`` [s] by the classical Runge-Kutta method of order 4.

    The controller acts at every stage: an effort held over each step would lead the motion by half a step, and a
    set-point held over each sample would pass for damping and rotor inertia. It sees the motors of the robot's state.
    """

    robot: Simulator
    controller: JointController
    step: float

    @property
    def steps(self) -> int:
        """Number of steps for which there are set-points."""
        return (len(self.controller.feedforward) - 1) // 2

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Accelerations ``(m,)`` of a state ``half_step / 2`` steps after the start."""
        motors = self.robot.driven
        effort = self.controller.effort(half_step, position[motors], velocity[motors])
        return self.robot.acceleration(position, velocity, effort)

    def advance(
        self, index: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """State one step after the instant ``index`` steps after the start, at which it has this ``acceleration``."""
        state = np.array([position, velocity])
        rates = [np.array([velocity, acceleration])]
        for share, half_step in ((0.5, 2 * index + 1), (0.5, 2 * index + 1), (1.0, 2 * index + 2)):
            reached, speed = state + share * self.step * rates[-1]
            rates.append(np.array([speed, self.acceleration(half_step, reached, speed)]))
        first, second, third, fourth = rates
        reached, speed = state + self.step * ((first + 2.0 * (second + third) + fourth) / 6.0)
        return reached, speed


@dataclass(frozen=True)
class Sampling:
    """Which steps of the integration are recorded: the joints every ``substeps``-th, ``samples`` of them, the wrench
    ``wrench_lag`` steps later each time; ``ahead`` steps are run on after the last sample of the joints."""

    samples: int
    substeps: int
    wrench_lag: int
    ahead: int

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        return (self.samples - 1) * self.substeps + self.ahead

    @property
    def joints(self) -> IntArray:
        """Steps after which the joints are sampled ``(T,)``."""
        return np.arange(self.samples) * self.substeps


def run(loop: ControlLoop, sampling: Sampling, progress: Callable[[float], None] | None = None) -> RunTrace:
    """Follow the controller's set-points from the first one and record as ``sampling`` specifies."""
    position, velocity = loop.robot.at_rest(loop.controller.setpoints.position[0])
    noted = set(sampling.joints.tolist())
    sensed = {step + sampling.wrench_lag for step in noted}
    rows, wrenches, efforts = [], [], []
    for index in range(sampling.steps + 1):
        acceleration = loop.acceleration(2 * index, position, velocity)
        efforts.append(loop.robot.effort())
        if index in sensed:
            wrenches.append(loop.robot.wrench())
        if index in noted:
            rows.append((position, velocity, acceleration))
            if progress is not None:
                progress(index / sampling.joints[-1])
        if index < sampling.steps:
            position, velocity = loop.advance(index, position, velocity, acceleration)
    return _trace(loop, sampling, rows, wrenches, efforts)


def _trace(
    loop: ControlLoop,
    sampling: Sampling,
    rows: list[tuple[FloatArray, FloatArray, FloatArray]],
    wrenches: list[FloatArray],
    efforts: list[FloatArray],
) -> RunTrace:
    at, motors, step = sampling.joints, loop.robot.driven, np.float64(loop.step)
    position, velocity, acceleration = (np.array(column)[:, motors] for column in zip(*rows, strict=True))
    return RunTrace(
        time=step * at,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        effort=np.array(efforts)[at],
        wrench_time=step * (at + sampling.wrench_lag),
        wrench=np.array(wrenches),
        commands=loop.controller.setpoints.select(2 * at),
        feedforward=loop.controller.feedforward[2 * at],
        fine_time=step * np.arange(len(efforts)),
        fine_effort=np.array(efforts),
    )


def check_motion(trace: RunTrace, joints: Sequence[UrdfLimits]) -> None:
    """Refuse a run that diverged, lost its set-points or reached the ends of the joints' ranges, whose stops are not
    measured."""
    lower, upper = np.array([(joint.lower, joint.upper) for joint in joints]).T
    inside = (trace.position > lower) & (trace.position < upper)
    followed = np.abs(trace.position - trace.commands.position) < _LOST
    if not (inside.all() and followed.all() and np.isfinite(trace.effort).all()):
        raise InputError(
            "the robot left its joints' ranges or its set-points: its drives are too weak for this motion. "
            "Lower motion_range, motion_speed or inertia_error, or lengthen motion_period."
        )


@dataclass(frozen=True, eq=False)
class TrueRobot:
    """The ``nominal`` model that its users know, the true ``bodies`` and ``effects``, and the ``plant`` made of them.

    ``joints`` are in the plant's order, ``bodies`` in that of the URDF.
    """

    nominal: Description
    bodies: tuple[LinkInertia, ...]
    effects: tuple[TrueEffect, ...]
    plant: Simulator
    joints: tuple[UrdfLimits, ...]

    def controlled(self, controller: JointController, step: float) -> ControlLoop:
        """The robot under control, in steps of ``step`` [s]."""
        return ControlLoop(self.plant, controller, step)

    def published(self, trace: RunTrace, options: SimulationOptions) -> RunTrace:
        """What arrives of a true motion: with effects of measurement, noise and resolution."""
        numbers = generator(options.recording_seed, RandomStream.NOISE)
        levels = self.noise(options)
        seen = sensed(trace, self.plant.joints, self.effects)
        memory = math.exp(-1.0 / (options.rate * options.noise_time)) if options.noise_time > 0.0 else 0.0
        position = _noisy(seen.position, levels["position"], 0.0, numbers)
        velocity = _noisy(seen.velocity, levels["velocity"], 0.0, numbers)
        effort = _noisy(seen.effort, levels["effort"], memory, numbers)
        return replace(
            seen,
            position=rounded(position, options.position_step * np.ones(len(self.joints))),
            velocity=velocity,
            effort=rounded(effort, options.effort_step * np.array([joint.effort for joint in self.joints])),
            wrench=_noisy(seen.wrench, levels["wrench"][: seen.wrench.shape[1]], memory, numbers),
        )

    def noise(self, options: SimulationOptions) -> dict[str, FloatArray]:
        """Standard deviations of each channel: position, velocity, effort ``(n,)`` and wrench ``(6,)``."""
        each = np.ones(len(self.joints))
        return {
            "position": options.position_noise * each,
            "velocity": options.velocity_noise * each,
            "effort": options.effort_noise * np.array([joint.effort for joint in self.joints]),
            "wrench": np.repeat([options.force_noise, options.torque_noise], 3),
        }

    def document(self) -> dict[str, Any]:
        """What the truth says of it beside links and noise: the ``effects``."""
        return {"effects": [effect.document for effect in self.effects]}


Builder = Callable[[Description, Iterable[LinkInertia], Iterable[TrueEffect], str | None], Simulator]
"""Makes a simulator of a kinematic tree, true bodies, effects and the frame of a wrench sensor."""


def build_robot(options: SimulationOptions, builder: Builder = Plant) -> TrueRobot:
    """The robot that ``options`` and their seed describe, in the simulator that ``builder`` makes."""
    nominal = read_description(robot_description(options.robot))
    numbers = generator(options.seed, RandomStream.INERTIA)
    bodies = tuple(perturbed(body, options.inertia_error, numbers) for body in nominal.inertias)
    effects = chosen_effects(options, nominal)
    plant = builder(nominal, bodies, effects, options.wrench_frame)
    limits = {joint.name: joint for joint in nominal.joints}
    return TrueRobot(nominal, bodies, effects, plant, tuple(limits[name] for name in plant.joints))


def _noisy(values: FloatArray, level: FloatArray, memory: float, numbers: np.random.Generator) -> FloatArray:
    """With noise of standard deviation ``level``, of which each sample keeps ``memory`` of the one before."""
    noise = numbers.standard_normal(values.shape)
    noise[1:] *= math.sqrt(1.0 - memory**2)
    for row in range(1, len(noise) if memory > 0.0 else 0):
        noise[row] += memory * noise[row - 1]
    return values + level * noise


def rounded(values: FloatArray, step: FloatArray) -> FloatArray:
    """In steps; as they are where there are none."""
    return np.round(values / step) * step if step.all() else values
