"""What the robot's sensors make of the true motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.simulation.description import UrdfLimits
from geomid_ros.simulation.effects.measurement import sensed
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.robot import TrueRobot
from geomid_ros.simulation.seeds import RandomStream, generator
from geomid_ros.simulation.trace import RunTrace
from geomid_ros.types import FloatArray


def noise_levels(joints: Sequence[UrdfLimits], options: SimulationOptions) -> dict[str, FloatArray]:
    """Standard deviations of each channel: position, velocity, effort ``(n,)`` and wrench ``(6,)``."""
    each = np.ones(len(joints))
    return {
        "position": options.position_noise * each,
        "velocity": options.velocity_noise * each,
        "effort": options.effort_noise * np.array([joint.effort for joint in joints]),
        "wrench": np.repeat([options.force_noise, options.torque_noise], 3),
    }


def measured(trace: RunTrace, robot: TrueRobot, options: SimulationOptions) -> RunTrace:
    """The trace with effects of measurement, noise and resolution."""
    numbers = generator(options.recording_seed, RandomStream.NOISE)
    levels = noise_levels(robot.joints, options)
    seen = sensed(trace, robot.plant.joints, robot.effects)
    memory = math.exp(-1.0 / (options.rate * options.noise_time)) if options.noise_time > 0.0 else 0.0
    limits = np.array([joint.effort for joint in robot.joints])
    position = _noisy(seen.position, levels["position"], 0.0, numbers)
    velocity = _noisy(seen.velocity, levels["velocity"], 0.0, numbers)
    effort = _noisy(seen.effort, levels["effort"], memory, numbers)
    return replace(
        seen,
        position=_rounded(position, options.position_step * np.ones(len(limits))),
        velocity=velocity,
        effort=_rounded(effort, options.effort_step * limits),
        wrench=_noisy(seen.wrench, levels["wrench"][: seen.wrench.shape[1]], memory, numbers),
    )


def _noisy(values: FloatArray, level: FloatArray, memory: float, numbers: np.random.Generator) -> FloatArray:
    """With noise of standard deviation ``level``, of which each sample keeps ``memory`` of the one before."""
    noise = numbers.standard_normal(values.shape)
    noise[1:] *= math.sqrt(1.0 - memory**2)
    for row in range(1, len(noise) if memory > 0.0 else 0):
        noise[row] += memory * noise[row - 1]
    return values + level * noise


def _rounded(values: FloatArray, step: FloatArray) -> FloatArray:
    return np.round(values / step) * step if step.all() else values
