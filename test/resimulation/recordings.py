"""Recordings of an arm whose efforts are pinocchio's for an exact motion: MuJoCo has no part in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np
from model.robots import Reference, fixed_base, with_values

from geomid_ros.files.models.effects_file import write_sidecar
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import ModelFiles
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import ResidualNoise
from geomid_ros.types import FloatArray

ARM = read_urdf(Path(__file__).parents[2] / "bags/arm3.urdf")
SENSOR = WrenchSensor("/wrench", "wrist_ft", "mounted", sign=-1.0)
MODEL = MeasurementModel(Robot(ARM, cuts=["wrist_ft"]), (), [SENSOR])
JOINTS = MODEL.robot.joint_names
PERIOD = 0.01
FLOOR = np.array([0.05, 0.05, 0.03, *(0.05,) * 3, *(0.005,) * 3])
"""Standard deviation of the noise by channel [N m, N]."""

# Position, velocity and acceleration, each (N, joints), to what the motors supply beside the rigid bodies (N, joints).
Added = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def motion(duration: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums of sines below 1.5 Hz and their derivatives, each ``(N, joints)``."""
    random = np.random.default_rng(seed)
    times = PERIOD * np.arange(round(duration / PERIOD))
    omega = 2.0 * np.pi * random.uniform(0.1, 1.5, (4, 3))
    size = random.uniform(0.3, 1.0, (4, 3)) / omega
    phase = times[:, None, None] * omega + random.uniform(0.0, 6.3, (4, 3))
    parts = size * np.sin(phase), size * omega * np.cos(phase), -size * omega**2 * np.sin(phase)
    position, velocity, acceleration = (part.sum(axis=1) for part in parts)
    return position, velocity, acceleration


def smooth_noise(count: int, seed: int) -> FloatArray:
    """Noise of the size of ``FLOOR`` below 8 Hz, as a filter leaves it, ``(count, channels)``."""
    random = np.random.default_rng(seed)
    spectrum = np.fft.rfft(random.normal(size=(count, len(FLOOR))), axis=0)
    spectrum[np.fft.rfftfreq(count, PERIOD) > 8.0] = 0.0
    noise = np.fft.irfft(spectrum, count, axis=0)
    return FLOOR * noise / np.sqrt(np.mean(noise**2, axis=0))


def noise_example(seed: int = 99) -> ResidualNoise:
    """The same kind of noise, at another time."""
    return ResidualNoise(tuple(channel.name for channel in MODEL.channels), PERIOD, smooth_noise(3000, seed))


def nothing(position: FloatArray, *_: FloatArray) -> FloatArray:
    """No effects."""
    return np.zeros_like(position)


@cache
def recording(
    added: Added = nothing, *, noise: float = 1.0, duration: float = 20.0, seed: int = 1, moves: bool = True
) -> Samples:
    """Samples of the arm; ``noise`` in units of ``FLOOR``. One that does not move stands where a motion begins."""
    position, velocity, acceleration = motion(duration, seed)
    if not moves:
        position, velocity, acceleration = np.tile(position[:1], (len(position), 1)), 0.0 * velocity, 0.0 * acceleration
    count = len(position)
    stamps = 10**12 + round(1e9 * PERIOD) * np.arange(count)
    joints = fixed_base(stamps, position, velocity, acceleration, np.zeros_like(position))
    still = with_values(joints, wrenches=np.zeros((count, 1, 6)))
    _, bodies = Reference(ARM).inverse_dynamics(still, JOINTS)
    disturbance = noise * smooth_noise(count, seed + 1000)
    effort = bodies + added(position, velocity, acceleration) + disturbance[:, :3]
    wrench = MODEL.rows(still).coefficients[:, 3:] @ MODEL.nominal_inertias + disturbance[:, 3:]
    return with_values(still, effort=effort, wrenches=SENSOR.sign * wrench[:, None])


def files(folder: Path, name: str, effects: Iterable[KnownEffect] = (), robot: Robot = MODEL.robot) -> ModelFiles:
    """The arm with these effects, written."""
    effects = list(effects)
    found = ModelFiles(folder / f"{name}.xml", folder / f"{name}.yaml")
    found.mjcf.write_text(mjcf(robot, {}, effects, [SENSOR]))
    write_sidecar(folder / f"{name}.yaml", "arm3", effects)
    return found
