"""A quadruped, and what it does on its feet."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.options import Options, option
from geomid_ros.simulation.options import LONGEST_STEP
from geomid_ros.types import FloatArray

_SHORTEST = 4.0  # [s] of a gait
_SMALLEST, _LARGEST = 1e-3, 1.0  # radii of feet [m]
_FADE = 0.7  # [s] at the beginning and at the end of a motion
_PERIOD, _SWING = 0.6, 0.4  # of the trot [s], and the share of it in which a foot is lifted

Gait = Callable[[FloatArray, FloatArray, np.random.Generator], tuple[FloatArray, FloatArray]]
"""From times ``(N,)`` and feet where they stand ``(feet, 3)``: the trunk's way ``(N, 6)``, translation and rotation
vector, and the feet's ``(N, feet, 3)``, both added to where they are at rest."""


def _faded(time: FloatArray, wait: float = 0.0) -> FloatArray:
    """From 0 to 1 and back ``(N, 1)``, smoothly, after a ``wait`` [s] at both ends."""
    share = np.clip((np.minimum(time, time[-1] - time) - wait) / _FADE, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))[:, None]


def _sway(time: FloatArray, size: FloatArray, numbers: np.random.Generator) -> FloatArray:
    """Sums of sines ``(N, len(size))``."""
    frequency = numbers.uniform(0.3, 1.5, (4, len(size)))
    phase = numbers.uniform(0.0, 2.0 * np.pi, frequency.shape)
    waves = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return np.asarray(_faded(time) * size * np.sum(waves, axis=1) / 3.0)


def _wobble(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    trunk = _sway(time, np.array([0.025, 0.02, 0.02, 0.08, 0.08, 0.08]), numbers)
    return trunk, np.zeros((len(time), *home.shape))


def _lift(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Each foot in turn leaves the ground and moves, the trunk over the other feet."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.01, 0.03, 0.03, 0.04]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, part in enumerate(np.array_split(np.arange(len(time)), len(home))):
        own = time[part] - time[part[0]]
        trunk[part, :2] -= 0.3 * home[foot, :2] * _faded(own)
        high = np.array([0.0, 0.0, 0.09])
        feet[part, foot] = _faded(own, _FADE) * (high + _sway(own, np.array([0.05, 0.04, 0.02]), numbers))
    return trunk, feet


def _trot(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Diagonal feet step together, on the spot."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.005, 0.02, 0.02, 0.02]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, (x, y, _) in enumerate(home):
        phase = (time / _PERIOD + (0.5 if x * y > 0.0 else 0.0)) % 1.0
        swing = np.clip(phase / _SWING, 0.0, 1.0)
        feet[:, foot, 2] = 0.05 * np.sin(np.pi * swing) ** 2 * _faded(time)[:, 0]
    return trunk, feet


GAITS: dict[str, Gait] = {"wobble": _wobble, "lift": _lift, "trot": _trot}
"""What a robot can do: sway with all feet down, lift its feet one by one, trot on the spot."""


@dataclass(frozen=True, kw_only=True)
class WalkOptions(Options):
    """A quadruped, its hidden truth, its gaits and its sensors. SI units; noise is Gaussian, given by its deviation.

    Attributes:
        robot: path of the URDF (the nominal model). Each leg has three joints: hip, thigh and knee.
        feet: the radius of each foot [m], by the link in whose origin its centre is.
        imu: link of the IMU.
        gaits: what the robot does, in turn, each for the same time: of :data:`GAITS`.
        payload: mass on the trunk that the URDF lacks [kg], ``payload_at`` in the root link's frame.
        inertia_error: relative error of the URDF's inertias.
        seed: fixes the robot; ``motion_seed`` motion and noise (``seed`` unless given).
        gyroscope_bias, accelerometer_bias: standard deviations of constant errors.
    """

    robot: str
    feet: Mapping[str, float]
    imu: str
    gaits: Sequence[str] = ("wobble", "lift", "trot")
    duration: float = 36.0
    rate: float = option(500.0, min=1.0, max=1.0 / LONGEST_STEP)
    seed: int = 1
    motion_seed: int | None = None
    payload: float = option(3.0, min=0.0)
    payload_at: tuple[float, float, float] = (0.04, 0.02, 0.08)
    inertia_error: float = option(0.1, min=0.0, max=1.0)
    viscous_friction: float = 0.1
    coulomb_friction: float = 0.2
    rotor_inertia: float = 0.01
    position_noise: float = 1e-4
    velocity_noise: float = 1e-2
    effort_noise: float = 0.1
    gyroscope_noise: float = 0.005
    gyroscope_bias: float = 0.003
    accelerometer_noise: float = 0.05
    accelerometer_bias: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        for gait in self.gaits:
            if gait not in GAITS:
                raise unknown_name("gait", gait, GAITS)
        shortest = _SHORTEST * len(self.gaits)
        if not shortest <= self.duration < math.inf:
            raise InputError(f"duration is {self.duration:g}, expected {shortest:g} or more")
        for foot, radius in self.feet.items():
            if not _SMALLEST <= radius <= _LARGEST:
                raise InputError(f"radius of {foot} is {radius:g}, expected {_SMALLEST:g} to {_LARGEST:g}")
        every = 1.0 / (self.rate * LONGEST_STEP)
        if not math.isclose(every, round(every)):
            raise InputError(
                f"rate is {self.rate:g}; it has to be {1.0 / LONGEST_STEP:g} Hz over a whole number, as 250 Hz"
            )

    @property
    def recording_seed(self) -> int:
        """Seed of the motion and of the noise."""
        return self.seed if self.motion_seed is None else self.motion_seed


def parse_feet(texts: Sequence[str]) -> dict[str, float]:
    """Radii by link, of ``LINK:RADIUS`` [m]. Raises InputError for another form."""
    feet = {}
    for text in texts:
        link, _, radius = text.partition(":")
        try:
            feet[link] = float(radius)
        except ValueError as error:
            raise InputError(f"foot '{text}' is not of the form LINK:RADIUS, e.g. FL_foot:0.022 [m]") from error
    return feet
