"""Recordings of an arm with a planted effect: exact motions, efforts by pinocchio's recursive algorithm, white noise.

Nothing here uses the regressors or the columns under test.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import scipy.linalg
from model.robots import fixed_base

from geomid_ros.gap.candidates import library_columns
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.inference.prior import Prior
from geomid_ros.model.effects import Motion
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Entries, Samples
from geomid_ros.types import FloatArray

BAGS = Path(__file__).parents[2] / "bags"
CUTOFF = 8.0
RATE = 64.0
NOISE = 0.02  # [N m]

Efforts = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]  # of q, v, a, each (N, joints)


@cache
def model() -> MeasurementModel:
    return MeasurementModel(Robot((BAGS / "arm3.urdf").read_text(encoding="utf-8")), ())


def prior(inertias: FloatArray | None = None, spread: float = 0.2) -> Prior:
    """What is thought of a robot without effects: these ``inertias (bodies, 10)``, the URDF's unless given."""
    known = model().nominal_inertias if inertias is None else inertias.ravel()
    nothing = np.zeros(0)
    return Prior(inertias=known, prior_std=spread, terms=(), values=nothing, prior_stds=nothing, certainty=4.0)


def true_inertias(seed: int, size: float) -> FloatArray:
    """The URDF's bodies, each moved along a random geodesic: ``(bodies, 10)``."""
    rng = np.random.default_rng(seed)
    bodies = []
    for body in model().robot.bodies:
        nominal = pseudo_inertia.from_parameters(body.parameters)
        direction = size * rng.standard_normal((4, 4))
        root = scipy.linalg.sqrtm(nominal)
        bodies.append(root @ spd.sym_exp(0.5 * (direction + direction.T)) @ root)
    return np.asarray(pseudo_inertia.to_parameters(np.array(bodies)))


def motion(seed: int, seconds: float, pace: float = 1.0) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times and a sum of six sines per joint, of period 6 s over ``pace``."""
    rng = np.random.default_rng([seed, 1])
    joints = len(model().robot.joints)
    times = np.arange(round(seconds * RATE)) / RATE
    position, velocity, acceleration = np.zeros((3, len(times), joints))
    for harmonic in range(1, 7):
        omega = 2.0 * np.pi * harmonic * pace / 6.0
        size, phase = 0.8 * rng.normal(size=joints) / harmonic, rng.uniform(0.0, 2.0 * np.pi, size=joints)
        angle = omega * times[:, None] + phase
        position += size * np.sin(angle)
        velocity += size * omega * np.cos(angle)
        acceleration -= size * omega**2 * np.sin(angle)
    return times, position, velocity, acceleration


def rigid(inertias: FloatArray, gravity: FloatArray | None = None) -> Efforts:
    """Efforts of rigid bodies."""
    built = model().robot.with_inertias(inertias, range(len(inertias)))
    if gravity is not None:
        built.gravity.linear = gravity
    data = built.createData()
    return lambda q, v, a: np.array([pin.rnea(built, data, *row) for row in zip(q, v, a, strict=True)])


def recording(
    efforts: Efforts,
    seed: int,
    seconds: float = 18.0,
    noise: FloatArray | float = NOISE,
    pace: float = 1.0,
    size: FloatArray | float = 1.0,
    posture: FloatArray | float = 0.0,
) -> Samples:
    """What is measured of a robot that takes these efforts, in a motion that is so many times as large, or of
    each joint so many times, about a ``posture (joints,)``."""
    times, *moving = motion(seed, seconds, pace)
    position, velocity, acceleration = (size * each for each in moving)
    position += posture
    measured = efforts(position, velocity, acceleration)
    measured = measured + noise * np.random.default_rng([seed, 2]).standard_normal(measured.shape)
    entries = Entries(library_columns(model()), position.shape[1])
    moved = Motion(np.array([position, velocity, acceleration]))
    stamps, moving = (1e9 + 1e9 * times).astype(np.int64), (position, velocity, acceleration)
    return fixed_base(stamps, *moving, measured, effects=entries.values(moved), entries=entries)
