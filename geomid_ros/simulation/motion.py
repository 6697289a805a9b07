"""Exciting motions within the joints' limits, faded in from rest, and the samples recorded in a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomid_ros.simulation.description import UrdfLimits
from geomid_ros.simulation.options import MOTIONS, SimulationOptions
from geomid_ros.types import FloatArray, IntArray

FADE_IN = 2.0
"""Time [s] from rest to full amplitude; afterwards ``sines`` are periodic."""


@dataclass(frozen=True, eq=False)
class SetPoints:
    """Set-points ``(T, n)`` of n joints at T times, with their exact first and second derivatives."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def select(self, index: Any) -> SetPoints:
        """Select set-points by an index of the arrays."""
        return SetPoints(self.position[index], self.velocity[index], self.acceleration[index])


def exciting_motion(
    times: FloatArray, joints: Sequence[UrdfLimits], options: SimulationOptions, rng: np.random.Generator
) -> SetPoints:
    """Random motion of ``joints`` at ``times (T,)`` [s], each joint as large as its limits and ``options`` allow."""
    shapes = _faded(times, _SHAPES[options.motion](times, len(joints), options, rng))
    excursion = options.motion_range * np.array([joint.half_range for joint in joints])
    speed = options.motion_speed * np.array([joint.velocity for joint in joints])
    scale = np.minimum(excursion / np.abs(shapes.position).max(0), speed / np.abs(shapes.velocity).max(0))
    centre = np.array([joint.centre for joint in joints])
    return SetPoints(centre + scale * shapes.position, scale * shapes.velocity, scale * shapes.acceleration)


def _sines(times: FloatArray, joints: int, options: SimulationOptions, rng: np.random.Generator) -> SetPoints:
    frequency = np.arange(1, options.motion_harmonics + 1) / options.motion_period
    return _sum_of_sines(times, np.tile(frequency[:, None], joints), rng)


def _aperiodic(times: FloatArray, joints: int, options: SimulationOptions, rng: np.random.Generator) -> SetPoints:
    harmonics = options.motion_harmonics
    frequency = rng.uniform(0.7, harmonics, (harmonics, joints)) / options.motion_period
    return _sum_of_sines(times, frequency, rng)


def _sum_of_sines(times: FloatArray, frequency: FloatArray, rng: np.random.Generator) -> SetPoints:
    """Sum of sines of ``frequency (sines, n)`` [Hz], with similar speed amplitudes."""
    omega = 2.0 * np.pi * frequency
    amplitude = rng.standard_normal(omega.shape) / omega
    phase = rng.uniform(0.0, 2.0 * np.pi, omega.shape)
    motion = _still(len(times), omega.shape[1])
    for speed, size, shift in zip(omega, amplitude, phase, strict=True):
        angle = speed * times[:, None] + shift
        sine = size * np.sin(angle)
        motion.position[:] += sine
        motion.velocity[:] += speed * size * np.cos(angle)
        motion.acceleration[:] -= speed**2 * sine
    return motion


def _chirp(times: FloatArray, joints: int, options: SimulationOptions, rng: np.random.Generator) -> SetPoints:
    """Sines whose frequencies rise linearly from about the slowest to the fastest; each joint starts at another one."""
    slow, fast = 1.0 / options.motion_period, options.motion_harmonics / options.motion_period
    start = slow * rng.uniform(0.7, 1.5, joints)
    rise = (fast - start) / max(times[-1], 1e-9)
    column = times[:, None]
    angle = rng.uniform(0.0, 2.0 * np.pi, joints) + 2.0 * np.pi * column * (start + 0.5 * rise * column)
    omega = 2.0 * np.pi * (start + rise * column)
    # sin(angle) / omega, of constant speed amplitude, and its derivatives
    sine, cosine, ratio = np.sin(angle), np.cos(angle), 2.0 * np.pi * rise / omega**2
    return SetPoints(
        sine / omega,
        cosine - ratio * sine,
        -omega * sine - ratio * omega * cosine + 2.0 * ratio**2 * omega * sine,
    )


def _points(times: FloatArray, joints: int, options: SimulationOptions, rng: np.random.Generator) -> SetPoints:
    """Motion between random points by trapezoids of speed, with a rest of a tenth of the time at each point.

    Each joint has a different rhythm, so that they do not all rest together.
    """
    motion = _still(len(times), joints)
    for joint in range(joints):
        lap = 0.5 * options.motion_period * rng.uniform(0.7, 1.3)
        count = int(times[-1] / lap) + 2
        points = np.concatenate([[0.0], rng.uniform(-1.0, 1.0, count)])
        laps, phase = np.divmod(times / lap, 1.0)
        leg = laps.astype(int)
        length = points[leg + 1] - points[leg]
        position, velocity, acceleration = _trapezoid(phase / 0.9)
        motion.position[:, joint] = points[leg] + length * position
        motion.velocity[:, joint] = length * velocity / (0.9 * lap)
        motion.acceleration[:, joint] = length * acceleration / (0.9 * lap) ** 2
    return motion


def _trapezoid(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position from 0 at x = 0 to 1 at x = 1 with a trapezoid of speed, and two derivatives; at rest above x = 1."""
    peak, quarter = 4.0 / 3.0, 0.25
    up, flat, down = np.minimum(x, quarter), np.clip(x - quarter, 0.0, 0.5), np.clip(x - 0.75, 0.0, quarter)
    position = peak * (2.0 * up**2 + flat + down - 2.0 * down**2)
    velocity = peak * 4.0 * (up - down)
    acceleration = np.where(x < quarter, 4.0 * peak, 0.0) - np.where((x >= 0.75) & (x < 1.0), 4.0 * peak, 0.0)
    return position, velocity, acceleration


def _still(samples: int, joints: int) -> SetPoints:
    return SetPoints(*(np.zeros((samples, joints)) for _ in range(3)))


def _faded(times: FloatArray, motion: SetPoints) -> SetPoints:
    """Multiply a motion by the smooth step ``6 x^5 - 15 x^4 + 10 x^3`` of ``x = t / FADE_IN``."""
    x = np.minimum(times[:, None] / FADE_IN, 1.0)
    fade = x**3 * (6.0 * x**2 - 15.0 * x + 10.0)
    rate = 30.0 * x**2 * (x - 1.0) ** 2 / FADE_IN
    bend = 60.0 * x * (2.0 * x**2 - 3.0 * x + 1.0) / FADE_IN**2
    return SetPoints(
        fade * motion.position,
        rate * motion.position + fade * motion.velocity,
        bend * motion.position + 2.0 * rate * motion.velocity + fade * motion.acceleration,
    )


_SHAPES: dict[str, Callable[[FloatArray, int, SimulationOptions, np.random.Generator], SetPoints]] = dict(
    zip(MOTIONS, (_sines, _aperiodic, _points, _chirp), strict=True)
)


_PER_JOINT = ("position", "velocity", "acceleration", "effort", "fine_effort", "feedforward")


@dataclass(frozen=True, eq=False)
class RunTrace:
    """Samples of n joints at T times.

    Attributes:
        time: ``(T,)`` [s].
        position, velocity, acceleration, effort: ``(T, n)``. Without measurement effects the effort is what the
            motors supply, and all four satisfy the equation of motion exactly.
        wrench_time: Times of the wrench samples ``(T,)`` [s].
        wrench: ``(T, 6)`` in the sensor's frame, or ``(T, 0)``.
        commands, feedforward: The controller's set-points and feed-forward efforts ``(T, n)`` at ``time``.
        fine_time, fine_effort: Times of all integration steps ``(F,)`` [s], and their efforts ``(F, n)``.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    wrench_time: FloatArray
    wrench: FloatArray
    commands: SetPoints
    feedforward: FloatArray
    fine_time: FloatArray
    fine_effort: FloatArray

    def reordered(self, order: IntArray) -> RunTrace:
        """Return the samples with the joints in another ``order (n,)``."""
        arrays = {name: getattr(self, name)[:, order] for name in _PER_JOINT}
        return replace(self, commands=self.commands.select(np.s_[:, order]), **arrays)


@dataclass(frozen=True, eq=False)
class WalkTrace:
    """N samples of a walk: ``time (N,)``; ``position, velocity, effort (N, joints)``; ``angular_velocity`` and
    ``specific_force (N, 3)`` in the IMU's axes; ``contact (N, feet)``, normal forces [N], which are not recorded."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    angular_velocity: FloatArray
    specific_force: FloatArray
    contact: FloatArray
