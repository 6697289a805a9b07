"""The robot as it truly is, and what its sensors make of its motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.simulation.description import Description, LinkInertia, UrdfLimits, read_description
from geomid_ros.simulation.effects.choice import chosen_effects
from geomid_ros.simulation.effects.physics import TrueEffect, sensed
from geomid_ros.simulation.inertias import perturbed
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant, Simulator
from geomid_ros.simulation.recorder import ControlLoop, JointController
from geomid_ros.simulation.robots import robot_description
from geomid_ros.types import FloatArray


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
            position=_rounded(position, options.position_step * np.ones(len(self.joints))),
            velocity=velocity,
            effort=_rounded(effort, options.effort_step * np.array([joint.effort for joint in self.joints])),
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


def _rounded(values: FloatArray, step: FloatArray) -> FloatArray:
    return np.round(values / step) * step if step.all() else values
