"""Exciting motions: a sum of sines per joint, faded in from rest, inside the joint's limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.simulation.description import JointLimits
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.types import FloatArray

FADE_IN = 2.0
"""Time [s] from rest to full amplitude; afterwards the motion is periodic."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Set-points ``(T, n)`` of n joints at T instants, with their exact first and second derivatives."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def exciting_motion(
    times: FloatArray, joints: Sequence[JointLimits], options: SimulationOptions, rng: np.random.Generator
) -> Motion:
    """A random motion of ``joints`` at ``times (T,)`` [s], each joint as large as its limits and ``options`` allow."""
    shapes = _faded(_fade(times), _sines(times, len(joints), options, rng))
    reach = options.motion_range * np.array([joint.half_range for joint in joints])
    speed = options.motion_speed * np.array([joint.velocity for joint in joints])
    scale = np.minimum(reach / np.abs(shapes.position).max(0), speed / np.abs(shapes.velocity).max(0))
    centre = np.array([joint.centre for joint in joints])
    return Motion(centre + scale * shapes.position, scale * shapes.velocity, scale * shapes.acceleration)


def _sines(times: FloatArray, joints: int, options: SimulationOptions, rng: np.random.Generator) -> Motion:
    frequency = 2.0 * np.pi / options.motion_period * np.arange(1, options.motion_harmonics + 1)
    amplitude = rng.standard_normal((options.motion_harmonics, joints)) / frequency[:, None]
    phase = rng.uniform(0.0, 2.0 * np.pi, (options.motion_harmonics, joints))
    motion = Motion(*(np.zeros((len(times), joints)) for _ in range(3)))
    for omega, size, shift in zip(frequency, amplitude, phase, strict=True):
        angle = omega * times[:, None] + shift
        sine = size * np.sin(angle)
        motion.position[:] += sine
        motion.velocity[:] += omega * size * np.cos(angle)
        motion.acceleration[:] -= omega**2 * sine
    return motion


def _fade(times: FloatArray) -> Motion:
    """The smooth step ``6 x^5 - 15 x^4 + 10 x^3`` of ``x = t / FADE_IN``, ``(T, 1)``, and its derivatives."""
    x = np.minimum(times[:, None] / FADE_IN, 1.0)
    return Motion(
        x**3 * (6.0 * x**2 - 15.0 * x + 10.0),
        30.0 * x**2 * (x - 1.0) ** 2 / FADE_IN,
        60.0 * x * (2.0 * x**2 - 3.0 * x + 1.0) / FADE_IN**2,
    )


def _faded(fade: Motion, motion: Motion) -> Motion:
    return Motion(
        fade.position * motion.position,
        fade.velocity * motion.position + fade.position * motion.velocity,
        fade.acceleration * motion.position
        + 2.0 * fade.velocity * motion.velocity
        + fade.position * motion.acceleration,
    )
