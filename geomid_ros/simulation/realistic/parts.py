"""What makes a robot realistic: friction, motors that give not quite what is commanded, lubricant that warms up;
encoders with steps, noisy currents, stamps that jitter, messages that are lost.

The friction is LuGre (Canudas de Wit, Olsson, Astrom, Lischinsky 1995): bristles that bend before the surfaces slide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.simulation.description import UrdfLimits
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import RandomStream, SimulationOptions, generator
from geomid_ros.types import BoolArray, FloatArray

_WAVES = ((8, 40), (60, 200))  # per turn: of the magnets, of the gear


@dataclass(frozen=True, eq=False)
class LuGre:
    """Friction of n joints; their bristles are bent by ``z (n,)`` [rad].

    ``dz/dt = v - |v| stiffness z / g(v)`` and ``F = stiffness z + damping exp(-(v/speed)^2) dz/dt + viscous v``, with
    the dry friction ``g(v) = level + excess exp(-(v/speed)^2)`` of steady sliding. The bristles' damping fades with
    speed, else friction would drive the joint where it slides fast (Olsson 1996).

    Attributes:
        level, excess: Dry friction while sliding fast ``(n,)``, and how much more it is near standstill [N m].
        speed: Where the excess has fallen to 37 % ``(n,)`` [rad/s].
        stiffness, damping: Of the bristles ``(n,)`` [N m/rad, N m s/rad].
        viscous: ``(n,)`` [N m s/rad], of a joint that is warm.
    """

    level: FloatArray
    excess: FloatArray
    speed: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    viscous: FloatArray

    def sliding(self, velocity: FloatArray) -> FloatArray:
        """Dry friction ``g(v) (n,)`` of steady sliding."""
        return self.level + self.excess * self._slow(velocity)

    def bent(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, step: float) -> FloatArray:
        """The bristles ``(n,)`` after ``step`` [s] at a constant velocity, under the ``dry`` friction g: exact."""
        end = np.sign(velocity) * dry / self.stiffness
        bent: FloatArray = end + (z - end) * np.exp(-step * np.abs(velocity) * self.stiffness / dry)
        return bent

    def force(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, cold: FloatArray | float = 1.0) -> FloatArray:
        """Friction ``(n,)`` [N m], opposite to the motion, where viscous friction is ``cold`` times its warm value."""
        rate = velocity - np.abs(velocity) * self.stiffness * z / dry
        force: FloatArray = (
            self.stiffness * z + self.damping * self._slow(velocity) * rate + cold * self.viscous * velocity
        )
        return force

    def _slow(self, velocity: FloatArray) -> FloatArray:
        slow: FloatArray = np.exp(-((velocity / self.speed) ** 2))
        return slow

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], rotors: dict[str, float], rng: np.random.Generator) -> LuGre:
        """Of joints with these inertias of their rotors."""
        limit, top, rotor = np.array([(joint.effort, joint.velocity, rotors[joint.name]) for joint in joints]).T
        n = len(joints)
        level = 0.025 * rng.uniform(0.5, 1.5, n) * limit
        speed = rng.uniform(0.01, 0.05, n) * top
        stiffness = level / rng.uniform(3e-4, 1e-3, n)
        return LuGre(
            level=level,
            excess=rng.uniform(0.1, 0.5, n) * level,
            speed=speed,
            stiffness=stiffness,
            damping=np.sqrt(stiffness * rotor),
            viscous=0.03 * rng.uniform(0.5, 1.5, n) * limit / top,
        )


@dataclass(frozen=True, eq=False)
class Motors:
    """n motors, each with its gear.

    Attributes:
        cogging: Efforts of the magnets and of the gear's teeth without current, ``(waves, n)`` [N m].
        ripple: Share of the commanded effort by which it varies over a turn ``(n,)``.
        cycles, phase: Waves of cogging per turn of the joint, and their phases ``(waves, n)`` [rad]; the ripple has
            twice the first.
        limit: Largest effort ``(n,)`` [N m].
    """

    cogging: FloatArray
    ripple: FloatArray
    cycles: FloatArray
    phase: FloatArray
    limit: FloatArray

    def supplied(self, commanded: FloatArray) -> FloatArray:
        """The commanded efforts ``(n,)`` within the limits: what the currents say."""
        return np.clip(commanded, -self.limit, self.limit)

    def unseen(self, effort: FloatArray, position: FloatArray) -> FloatArray:
        """What reaches the joints ``(n,)`` beyond the efforts that the currents say."""
        angles = self.cycles * position + self.phase
        cogging = (self.cogging * np.sin(angles)).sum(axis=0)
        unseen: FloatArray = cogging + self.ripple * effort * np.sin(2.0 * angles[0])
        return unseen

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], rng: np.random.Generator) -> Motors:
        """Those of joints."""
        limit = np.array([joint.effort for joint in joints])
        n = len(joints)
        return Motors(
            cogging=np.stack([rng.uniform(0.5e-3, 3e-3, n) * limit for _ in _WAVES]),
            ripple=rng.uniform(3e-3, 1.5e-2, n),
            cycles=np.stack([rng.integers(*waves, n).astype(np.float64) for waves in _WAVES]),
            phase=rng.uniform(0.0, 2.0 * np.pi, (len(_WAVES), n)),
            limit=limit,
        )


@dataclass(frozen=True, eq=False)
class WarmUp:
    """Viscous friction is ``1 + excess exp(-t / time)`` times its warm value: ``excess (n,)``, ``time`` [s]."""

    excess: FloatArray
    time: float

    def cold(self, instant: float) -> FloatArray:
        """The factor ``(n,)`` at an instant [s]."""
        return 1.0 + self.excess * math.exp(-instant / self.time)

    @staticmethod
    def drawn(joints: int, options: SimulationOptions) -> WarmUp:
        """The robot's by its seed; how cold it is when the recording starts by that of the recording."""
        rng = generator(options.seed, RandomStream.REALISTIC, 4)
        excess, time = rng.uniform(0.05, 0.2, joints), rng.uniform(30.0, 120.0)
        return WarmUp(excess * generator(options.recording_seed, RandomStream.REALISTIC, 6).uniform(0.3, 1.0), time)


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
    arrays = {name: getattr(trace, name)[arrives] for name in per_message}
    return replace(trace, commands=trace.commands.select(arrives), **arrays)
