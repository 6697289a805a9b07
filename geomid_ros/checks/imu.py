"""What an identification says of the IMU that it relies on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.effects import effect_class
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_TURNED = 1.0  # [deg]
_SURE = 3.0  # standard deviations
_DISPLACED = 0.03  # [m]
_ALIKE = 0.5  # halves of a recording agree if they differ by less than this share


def turned_imu(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """That the IMU is turned or biased, in a sentence, if it is so by more than a degree."""
    offsets = [effect for effect in estimate.effects if effect_class(effect.name).place == "base"]
    force = math.hypot(*(offset.value for offset in offsets))
    std = math.hypot(*(offset.std for offset in offsets))
    acceleration = force / _mass(model, estimate.parameters)
    angle = math.degrees(math.atan(acceleration / np.linalg.norm(model.robot.gravity)))
    if angle < _TURNED or force < _SURE * std:
        return []
    sentence = (
        f"the IMU seems to be turned by {angle:.1f} degrees against its frame in the URDF, or its acceleration across "
        f"gravity is off by {acceleration:.2f} m/s^2; that is compensated. Calibrate it, or correct the frame"
    )
    return [sentence]


def displaced_imu(model: MeasurementModel, batches: Sequence[Samples], parameters: FloatArray) -> tuple[Finding, ...]:
    """That the IMU is elsewhere than the URDF says, if both halves of the samples show it.

    An error d of its place leaves ``-m (alpha x d + omega x (omega x d))`` of the force on the base. A centre of mass
    that is off would leave the same, but that is known from the moments.

    Args:
        model: of a robot.
        batches: what is judged on.
        parameters: the estimate's ``(D,)``.
    """
    if not model.layout.base or not batches:
        return ()
    samples = Samples.concatenate(list(batches))
    measured, predicted = model.predict(samples, parameters)
    left = (measured - predicted)[:, model.layout.base[:3]]
    known = np.flatnonzero(np.isfinite(left).all(axis=1))
    turning, tilting = (_crossing(rates[known, 3:]) for rates in (samples.base_velocity, samples.base_acceleration))
    levers = -_mass(model, parameters) * (tilting + turning @ turning)
    halves = np.array_split(known, 2), np.array_split(levers, 2)
    places = [
        np.linalg.lstsq(half.reshape(-1, 3), left[own].ravel(), rcond=None)[0]
        for own, half in zip(*halves, strict=True)
    ]
    place = 0.5 * (places[0] + places[1])
    distance = float(np.linalg.norm(place))
    if distance < _DISPLACED or np.linalg.norm(places[0] - places[1]) > _ALIKE * distance:
        return ()
    x, y, z = (1e3 * place).round().astype(int)
    sentence = (
        f"the IMU seems to be {1e3 * distance:.0f} mm from its place in the URDF, by ({x:+d}, {y:+d}, {z:+d}) mm in "
        "the axes of the base, or a foot that stands is missing in --contacts: the inertia and the centre of mass of "
        "the base are off. Measure its place, and name all feet"
    )
    return (Finding(cause=Cause(kind="imu", sentence=sentence)),)


def _mass(model: MeasurementModel, parameters: FloatArray) -> float:
    """The robot's mass [kg] by an estimate."""
    nominal = model.nominal_inertias[::10]
    described = model.robot.weight / float(np.linalg.norm(model.robot.gravity))
    return described + float(np.sum(parameters[: 10 * len(nominal) : 10] - nominal))


def _crossing(vectors: FloatArray) -> FloatArray:
    """The matrices ``(N, 3, 3)`` of cross products with ``vectors (N, 3)``."""
    return np.asarray(np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1))
