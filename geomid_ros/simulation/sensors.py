"""What the robot's sensors make of the true motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.simulation.description import JointLimits
from geomid_ros.simulation.effects import measured_effort
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recorder import Trace
from geomid_ros.simulation.robot import Robot
from geomid_ros.simulation.seeds import Stream, generator
from geomid_ros.types import FloatArray


def noise_levels(joints: Sequence[JointLimits], options: SimulationOptions) -> dict[str, FloatArray]:
    """Standard deviations of each channel: position, velocity, effort ``(n,)`` and wrench ``(6,)``."""
    each = np.ones(len(joints))
    return {
        "position": options.position_noise * each,
        "velocity": options.velocity_noise * each,
        "effort": options.effort_noise * np.array([joint.effort for joint in joints]),
        "wrench": np.repeat([options.force_noise, options.torque_noise], 3),
    }


def measured(trace: Trace, robot: Robot, options: SimulationOptions) -> Trace:
    """The trace with effects of measurement and noise."""
    numbers = generator(options.recording_seed, Stream.NOISE)
    levels = noise_levels(robot.joints, options)
    effort = measured_effort(trace.effort, robot.plant.joints, robot.effects)
    return replace(
        trace,
        position=_noisy(trace.position, levels["position"], numbers),
        velocity=_noisy(trace.velocity, levels["velocity"], numbers),
        effort=_noisy(effort, levels["effort"], numbers),
        wrench=_noisy(trace.wrench, levels["wrench"][: trace.wrench.shape[1]], numbers),
    )


def _noisy(values: FloatArray, level: FloatArray, numbers: np.random.Generator) -> FloatArray:
    return values + level * numbers.standard_normal(values.shape)
