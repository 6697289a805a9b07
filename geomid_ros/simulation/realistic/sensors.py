"""What is published of a motion: encoders with steps, noisy currents, stamps that jitter, messages that are lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.simulation.description import UrdfLimits
from geomid_ros.simulation.motion import RunTrace, SetPoints
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Sensors:
    """Sensors of n joints and the way of their messages.

    Attributes:
        encoder: Steps of the positions ``(n,)`` [rad].
        window: Time over which the drive differentiates them [s].
        effort_noise, effort_step: Standard deviation and resolution of efforts ``(n,)`` [N m].
        wrench_noise: Standard deviations of force and torque ``(6,)`` [N, N m].
        jitter: Standard deviation of the stamps [s].
        lost: Share of messages that are lost. burst: How many are lost one after the other, on average.
    """

    encoder: FloatArray
    window: float
    effort_noise: FloatArray
    effort_step: FloatArray
    wrench_noise: FloatArray
    jitter: float
    lost: float
    burst: float

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], options: SimulationOptions, rng: np.random.Generator) -> Sensors:
        """Those of joints."""
        limit = np.array([joint.effort for joint in joints])
        n = len(joints)
        return Sensors(
            encoder=2.0 * np.pi * 0.5 ** rng.integers(17, 21, n).astype(np.float64),
            window=rng.uniform(1e-3, 3e-3),
            effort_noise=rng.uniform(1e-3, 4e-3, n) * limit,
            effort_step=rng.uniform(2e-4, 1.5e-3, n) * limit,
            wrench_noise=np.repeat([options.force_noise, options.torque_noise], 3),
            jitter=rng.uniform(0.02, 0.06) / options.rate,
            lost=rng.uniform(1e-3, 1e-2),
            burst=rng.uniform(1.0, 3.0),
        )


def published(trace: RunTrace, sensors: Sensors, rng: np.random.Generator) -> RunTrace:
    """What arrives of a ``trace`` of true positions, velocities and accelerations, and efforts before noise."""
    early = trace.position - sensors.window * (trace.velocity - 0.5 * sensors.window * trace.acceleration)
    position, before = (_stepped(each, sensors.encoder) for each in (trace.position, early))
    effort = trace.effort + sensors.effort_noise * rng.standard_normal(trace.effort.shape)
    wrench = trace.wrench + sensors.wrench_noise[: trace.wrench.shape[1]] * rng.standard_normal(trace.wrench.shape)
    late = _jitter(trace.time, sensors.jitter, rng)
    seen = replace(
        trace,
        time=trace.time + late,
        wrench_time=trace.wrench_time + late,
        position=position,
        velocity=(position - before) / sensors.window,
        effort=_stepped(effort, sensors.effort_step),
        wrench=wrench,
    )
    return _arrived(seen, kept(len(trace.time), sensors.lost, sensors.burst, rng))


def kept(messages: int, lost: float, burst: float, rng: np.random.Generator) -> BoolArray:
    """Which messages arrive ``(T,)``: a two-state chain (Gilbert 1960); the first and the last always do."""
    ends, begins = 1.0 / burst, lost / (burst * (1.0 - lost))
    draws, arrives, up = rng.uniform(size=messages), np.ones(messages, dtype=np.bool_), True
    for index, draw in enumerate(draws.tolist()):
        up = draw >= begins if up else draw < ends
        arrives[index] = up
    arrives[[0, -1]] = True
    return arrives


def _jitter(time: FloatArray, size: float, rng: np.random.Generator) -> FloatArray:
    """Errors of stamps ``(T,)`` [s], cut where two stamps could change places and where the first is before zero."""
    most = 0.45 * float(np.min(np.diff(time)))
    errors: FloatArray = np.clip(size * rng.standard_normal(len(time)), -most, most)
    errors[0] = abs(errors[0])
    return errors


def _stepped(values: FloatArray, step: FloatArray) -> FloatArray:
    stepped: FloatArray = np.round(values / step) * step
    return stepped


def _arrived(trace: RunTrace, arrives: BoolArray) -> RunTrace:
    per_message = ("time", "position", "velocity", "acceleration", "effort", "wrench_time", "wrench", "feedforward")
    commands = SetPoints(*(values[arrives] for values in vars(trace.commands).values()))
    return replace(trace, commands=commands, **{name: getattr(trace, name)[arrives] for name in per_message})
