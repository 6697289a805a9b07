"""True robot: its control, its true motion at the recorded samples, and the sensors' measurements of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import (
    Description,
    LinkInertia,
    UrdfLimits,
    perturbed,
    read_description,
    robot_description,
)
from geomid_ros.simulation.effect_sizes import chosen_effects
from geomid_ros.simulation.effects import TrueEffect, noiseless_measurement
from geomid_ros.simulation.motion import RunTrace, SetPoints
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant, Simulator
from geomid_ros.types import FloatArray, IntArray

_STIFFNESS = 10.0  # effort limits per rad (or m) of position error
_STABLE = 0.8  # decay per step of one joint by the controller's damping; for all together Runge-Kutta allows 2.8
_LOST = 0.3  # [rad or m] from the set-point
_LOOK = 0.05  # [s] between the set-points at which stability is checked


@dataclass(frozen=True, eq=False)
class JointController:
    """Feed-forward by a model's inverse dynamics and PD feedback; set-points ``(2 S + 1, n)`` are half a step apart."""

    setpoints: SetPoints
    feedforward: FloatArray
    stiffness: FloatArray
    damping: FloatArray

    def effort(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Commanded efforts ``(n,)`` at ``half_step / 2`` steps after the start."""
        return np.asarray(
            self.feedforward[half_step]
            + self.stiffness * (self.setpoints.position[half_step] - position)
            + self.damping * (self.setpoints.velocity[half_step] - velocity)
        )

    def slowed(self, robot: Simulator, step: float) -> JointController:
        """Reduce the damping where the ``robot`` would respond faster than steps of ``step`` [s] can follow.

        A joint that moves alone, the others free, has the inertia ``1 / (M^-1)_jj``. It is small for a light rotor at
        an elastic gear, or where the axes of two joints nearly coincide.
        """
        positions = self.setpoints.position[:: max(1, round(_LOOK / step))]
        inverses = (np.linalg.inv(robot.inertia_matrix(robot.at_rest(position)[0])) for position in positions)
        least_inertia = 1.0 / np.max([np.diag(inverse)[robot.driven] for inverse in inverses], axis=0)
        return replace(self, damping=np.minimum(self.damping, _STABLE * least_inertia / step))


def tuned_controller(
    setpoints: SetPoints, nominal: Simulator, robot: Simulator, joints: Sequence[UrdfLimits], tuned_on: Simulator
) -> JointController:
    """Build a controller that knows the ``nominal`` model, with gains ``tuned_on`` that or on the ``robot``.

    The gains make the loop critically damped at the start; a constant effort holds the robot at rest there.
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

    The controller acts at every stage: an effort held over each step would lead the motion by half a step. A
    set-point held over each sample would look like damping and rotor inertia. It receives the motors' states only.
    """

    robot: Simulator
    controller: JointController
    step: float

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Accelerations ``(m,)`` of a state ``half_step / 2`` steps after the start."""
        motors = self.robot.driven
        effort = self.controller.effort(half_step, position[motors], velocity[motors])
        return self.robot.acceleration(position, velocity, effort)

    def advance(
        self, index: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """State after the step ``index``, at whose beginning the robot has this ``acceleration``."""
        state = np.array([position, velocity])
        rates = [np.array([velocity, acceleration])]
        for fraction, half_step in ((0.5, 2 * index + 1), (0.5, 2 * index + 1), (1.0, 2 * index + 2)):
            reached, speed = state + fraction * self.step * rates[-1]
            rates.append(np.array([speed, self.acceleration(half_step, reached, speed)]))
        first, second, third, fourth = rates
        reached, speed = state + self.step * ((first + 2.0 * (second + third) + fourth) / 6.0)
        return reached, speed


@dataclass(frozen=True)
class Sampling:
    """Recorded integration steps: ``samples`` of the joints, one every ``substeps``, and the wrench ``wrench_lag``
    steps after each. The run continues for ``ahead`` steps after the last sample of the joints."""

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
    joint_steps = set(sampling.joints.tolist())
    wrench_steps = {step + sampling.wrench_lag for step in joint_steps}
    rows, wrenches, efforts = [], [], []
    for index in range(sampling.steps + 1):
        acceleration = loop.acceleration(2 * index, position, velocity)
        efforts.append(loop.robot.effort())
        if index in wrench_steps:
            wrenches.append(loop.robot.wrench())
        if index in joint_steps:
            rows.append((position, velocity, acceleration))
            if progress is not None:
                progress(index / sampling.joints[-1])
        if index < sampling.steps:
            position, velocity = loop.advance(index, position, velocity, acceleration)
    steps, motors, step = sampling.joints, loop.robot.driven, np.float64(loop.step)
    position, velocity, acceleration = (np.array(column)[:, motors] for column in zip(*rows, strict=True))
    return RunTrace(
        time=step * steps,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        effort=np.array(efforts)[steps],
        wrench_time=step * (steps + sampling.wrench_lag),
        wrench=np.array(wrenches),
        commands=loop.controller.setpoints.select(2 * steps),
        feedforward=loop.controller.feedforward[2 * steps],
        fine_time=step * np.arange(len(efforts)),
        fine_effort=np.array(efforts),
    )


def check_motion(trace: RunTrace, joints: Sequence[UrdfLimits]) -> None:
    """Refuse a run that diverged, lost its set-points or reached the ends of the joints' ranges, because forces of the
    stops are not measured."""
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
    """The ``nominal`` model that users know, the true ``bodies`` and ``effects``, and the ``plant`` built from them.

    ``joints`` are in the plant's order, ``bodies`` in that of the URDF.
    """

    nominal: Description
    bodies: tuple[LinkInertia, ...]
    effects: tuple[TrueEffect, ...]
    plant: Simulator
    joints: tuple[UrdfLimits, ...]

    def controlled(self, controller: JointController, step: float) -> ControlLoop:
        """Put the robot under control, in steps of ``step`` [s]."""
        return ControlLoop(self.plant, controller, step)

    def published(self, trace: RunTrace, options: SimulationOptions) -> RunTrace:
        """Measurements of a true motion: with measurement effects, noise and resolution."""
        numbers = generator(options.recording_seed, RandomStream.NOISE)
        levels = self.noise(options)
        measured = noiseless_measurement(trace, self.plant.joints, self.effects)
        memory = math.exp(-1.0 / (options.rate * options.noise_time)) if options.noise_time > 0.0 else 0.0
        position = _noisy(measured.position, levels["position"], 0.0, numbers)
        velocity = _noisy(measured.velocity, levels["velocity"], 0.0, numbers)
        effort = _noisy(measured.effort, levels["effort"], memory, numbers)
        return replace(
            measured,
            position=rounded(position, options.position_step * np.ones(len(self.joints))),
            velocity=velocity,
            effort=rounded(effort, options.effort_step * np.array([joint.effort for joint in self.joints])),
            wrench=_noisy(measured.wrench, levels["wrench"][: measured.wrench.shape[1]], memory, numbers),
        )

    def noise(self, options: SimulationOptions) -> dict[str, FloatArray]:
        """Noise standard deviations of the channels: position, velocity, effort ``(n,)`` and wrench ``(6,)``."""
        ones = np.ones(len(self.joints))
        return {
            "position": options.position_noise * ones,
            "velocity": options.velocity_noise * ones,
            "effort": options.effort_noise * np.array([joint.effort for joint in self.joints]),
            "wrench": np.repeat([options.force_noise, options.torque_noise], 3),
        }

    def document(self) -> dict[str, Any]:
        """Entries of the truth file in addition to links and noise: the ``effects``."""
        return {"effects": [effect.document for effect in self.effects]}


Builder = Callable[[Description, Iterable[LinkInertia], Iterable[TrueEffect], str | None], Simulator]
"""Function that builds a simulator from a kinematic tree, true bodies, effects and the frame of a wrench sensor."""


def build_robot(options: SimulationOptions, builder: Builder = Plant) -> TrueRobot:
    """Build the robot that ``options`` and their seed describe, in the simulator of ``builder``."""
    nominal = read_description(robot_description(options.robot))
    numbers = generator(options.seed, RandomStream.INERTIA)
    bodies = tuple(perturbed(body, options.inertia_error, numbers) for body in nominal.inertias)
    effects = chosen_effects(options, nominal)
    plant = builder(nominal, bodies, effects, options.wrench_frame)
    limits = {joint.name: joint for joint in nominal.joints}
    return TrueRobot(nominal, bodies, effects, plant, tuple(limits[name] for name in plant.joints))


def _noisy(values: FloatArray, level: FloatArray, memory: float, numbers: np.random.Generator) -> FloatArray:
    """Add autoregressive noise of standard deviation ``level``, with correlation ``memory`` between samples."""
    noise = numbers.standard_normal(values.shape)
    noise[1:] *= math.sqrt(1.0 - memory**2)
    for row in range(1, len(noise) if memory > 0.0 else 0):
        noise[row] += memory * noise[row - 1]
    return values + level * noise


def rounded(values: FloatArray, step: FloatArray) -> FloatArray:
    """Round to multiples of ``step``; return the values unchanged if a step is 0."""
    return np.round(values / step) * step if step.all() else values
