"""Checks of a moving base: weight on its legs and signs of their efforts, place of its IMU, agreement of its gyroscope
with the legs.

Feet on the ground determine how the base rotates, from the encoders alone: their contact points do not move. For that
no mass and no effort is used, so that nothing that is identified can hide a fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.checks.causes import Cause, gain_settings
from geomid_ros.checks.evidence import MOST
from geomid_ros.checks.sample_reservoir import FEWEST, STEP
from geomid_ros.estimation.estimate import SIGNIFICANT_STDS, Estimate
from geomid_ros.model.effects import effect_class
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import DIRECTIONS, Contact, Legs
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.se3 import best_rotation, rotation_angle
from geomid_ros.signals.moving_base import LIFTED, within
from geomid_ros.types import BoolArray, FloatArray

_USUAL = 0.5, 3.0  # plausible multiples of the URDF's weight, which may lack a payload
_TURNED = 1.0  # [deg]
_DISPLACED = 0.03  # [m]


def unnamed_feet(robot: Robot, legs: Legs, samples: Samples) -> list[Cause]:
    """Report limbs without a named contact that seem to support the robot, too; ``samples`` are any of a recording."""
    bearing = {tip: _weight_on(Legs(robot, [Contact(tip)]), samples) for tip in _unnamed_tips(robot, legs)}
    named = ", ".join(f"{100.0 * share:.0f} % at '{tip}'" for tip, share in bearing.items() if share > LIFTED)
    sentence = (
        f"limbs without a declared contact seem to support a part of the robot's weight: {named}. Declare "
        "their feet (--contacts)"
    )
    return [Cause(kind="legs", sentence=sentence)] if named else []


def feet_of_fixed(robot: Robot, samples: Samples) -> list[str]:
    """Ends of the limbs of a ``robot`` with a floating base, if it stands on them in ``samples`` of one that counts as
    fixed: its efforts support its weight there. Empty if they do not."""
    tips = _unnamed_tips(robot, Legs(robot, []))
    still, level = np.zeros((len(samples), 6)), np.tile(np.eye(7)[6], (len(samples), 1))
    moving = replace(samples, base_pose=level, base_velocity=still, base_acceleration=still)
    share = _weight_on(Legs(robot, [Contact(tip) for tip in tips]), moving) if len(tips) > 1 else 0.0
    return tips if _USUAL[0] <= share <= _USUAL[1] else []


def _weight_on(legs: Legs, samples: Samples) -> float:
    """Mean fraction of the URDF's weight on the feet, by the efforts of their legs; NaN if it is unknown."""
    shares = legs.weight_fraction(samples)
    known = np.isfinite(shares)
    return float(np.mean(shares[known])) if known.any() else math.nan


def _unnamed_tips(robot: Robot, legs: Legs) -> list[str]:
    """Ends of other limbs of three joints or more: of the links without children, the farthest from the last joint."""
    named, tips = {robot.joint_names[joint] for joints in legs.joints for joint in joints}, dict[str, str]()
    for link in robot.tree.links:
        moving = [joint.name for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names]
        if robot.tree.children(link) or len(moving) < DIRECTIONS or named.intersection(moving):
            continue
        last = tips.get(moving[0], link)
        tips[moving[0]] = max(link, last, key=lambda tip: _reach(robot, tip))
    return list(tips.values())


def _reach(robot: Robot, link: str) -> float:
    """Distance of a link from the joint that moves it [m]."""
    moved = next(joint.child for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names)
    return float(np.linalg.norm(robot.fixed_placement(link, moved)[:3, 3]))


def never_lifted(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """Sentence if legs have no fitted rows: with the friction of a fast swing, short steps bear a load; else empty."""
    if model.legs is None:
        return []
    rms = dict(zip(estimate.channels, estimate.rms, strict=True))
    standing = [
        contact.frame
        for contact, joints in zip(model.legs.contacts, model.legs.joints, strict=True)
        if not np.any(np.isfinite([rms[model.robot.joint_names[joint]] for joint in joints]))
    ]
    sentence = (
        f"the training data show {', '.join(standing)} never long enough in the air (the short steps of a trot are "
        "not): for these legs only parameters that the base wrench depends on are identifiable. Lift each leg and move "
        "it in the air for two seconds or more; if you did, that part was held out (--hold-out 0 fits it, too)"
    )
    return [sentence] if standing else []


def unknown_base(model: MeasurementModel, estimate: Estimate) -> list[Cause]:
    """Report if legs are declared, and no row of the base was fitted."""
    rms = np.array(estimate.rms)[list(model.layout.base)]
    if model.legs is None or np.any(np.isfinite(rms)):
        return []
    sentence = (
        "the base and what it carries are not identified: ground reaction forces are unknown, as efforts are needed of "
        "all joints of the legs that stand. Let the driver publish them, or compute them from set-points: "
        "--command TOPIC with --gains KP:KD"
    )
    return [Cause(kind="ground", sentence=sentence)]


def carried_weight(legs: Legs, samples: Samples) -> list[Cause]:
    """Report if by the efforts of the legs the feet do not support the robot; ``samples`` are any of a recording."""
    share = _weight_on(legs, samples)
    if math.isnan(share) or _USUAL[0] <= share <= _USUAL[1]:
        return []
    sentence = (
        f"leg efforts support {share:.2g} of the robot's weight on average (expected about 1): "
        "check that efforts are in N m with their sign (effort_gain, --gain), that all feet are named (contacts), and "
        "that the IMU's frame is not upside down"
    )
    return [Cause(kind="legs", sentence=sentence)]


def reversed_efforts(legs: Legs, samples: Samples, names: Sequence[str], gains: FloatArray) -> list[Cause]:
    """Report the legs' joints whose efforts support and move the robot only with the other sign, by both halves of the
    samples. If most are reversed, the IMU may be upside down, see :func:`carried_weight`.

    Efforts are scaled by a factor each to give the wrench that the URDF's links require of the ground. Friction and
    other masses change the factors, but not their signs.

    Args:
        legs: of the robot.
        samples: any of a recording.
        names: of all joints.
        gains: ``(joints,)`` factors on the messages' efforts.
    """
    parts, required = legs.balance(samples)
    joints = np.concatenate(legs.joints)
    known = np.flatnonzero(np.isfinite(parts).all(axis=(1, 2)))
    if len(known) < FEWEST:
        return []
    scales = np.maximum(np.std(required[known], axis=0), np.finfo(float).tiny)
    parts, required = parts[:, :, joints] / scales[:, None], required / scales
    halves = [
        np.linalg.lstsq(np.concatenate(parts[half]), required[half].ravel(), rcond=None)[0]
        for half in np.array_split(known, 2)
    ]
    factors = np.mean(halves, axis=0)
    contrary = joints[(factors < 0.0) & (np.ptp(halves, axis=0) < MOST * np.abs(factors))]
    if not len(contrary) or np.mean(factors < 0.0) > MOST:
        return []
    places = [names[joint] for joint in contrary]
    cause = Cause.of("sign", places, gain_settings(places, -gains[contrary], all_joints=False))
    return [replace(cause, kind="legs")]


def turned_imu(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """Sentence if the IMU is rotated or biased by more than a degree; else empty."""
    offsets = [effect for effect in estimate.effects if effect_class(effect.name).place == "base"]
    force = math.hypot(*(offset.value for offset in offsets))
    std = math.hypot(*(offset.std for offset in offsets))
    acceleration = force / _mass(model, estimate.parameters)
    angle = math.degrees(math.atan(acceleration / np.linalg.norm(model.robot.gravity)))
    if angle < _TURNED or force < SIGNIFICANT_STDS * std:
        return []
    sentence = (
        f"the IMU seems to be turned by {angle:.1f} degrees against its frame in the URDF, or its acceleration across "
        f"gravity is off by {acceleration:.2f} m/s^2; that is compensated. Calibrate it, or correct the frame"
    )
    return [sentence]


def displaced_imu(model: MeasurementModel, batches: Sequence[Samples], parameters: FloatArray) -> list[Cause]:
    """Report if the IMU is not at its place in the URDF, and both halves of the samples show it.

    A position error d leaves ``-m (alpha x d + omega x (omega x d))`` of the force on the base. A wrong centre of mass
    would leave the same, but that is known from the moments.

    Args:
        model: of a robot.
        batches: samples to evaluate on.
        parameters: the estimate's ``(D,)``.
    """
    if not model.layout.base or not batches:
        return []
    samples = Samples.concatenate(list(batches))
    measured, predicted = model.predict(samples, parameters)
    residual = (measured - predicted)[:, model.layout.base[:3]]
    finite = np.flatnonzero(np.isfinite(residual).all(axis=1))
    turning, tilting = (_crossing(rates[finite, 3:]) for rates in (samples.base_velocity, samples.base_acceleration))
    levers = -_mass(model, parameters) * (tilting + turning @ turning)
    first, second = (
        np.linalg.lstsq(half.reshape(-1, 3), residual[rows].ravel(), rcond=None)[0]
        for rows, half in zip(np.array_split(finite, 2), np.array_split(levers, 2), strict=True)
    )
    place = 0.5 * (first + second)
    distance = float(np.linalg.norm(place))
    if distance < _DISPLACED or np.linalg.norm(first - second) > MOST * distance:
        return []
    x, y, z = (1e3 * place).round().astype(int)
    sentence = (
        f"the IMU seems to be {1e3 * distance:.0f} mm from its place in the URDF, by ({x:+d}, {y:+d}, {z:+d}) mm in "
        "the axes of the base, or a foot that stands is missing in --contacts: the inertia and the centre of mass of "
        "the base are off. Measure its place, and name all feet"
    )
    return [Cause(kind="imu", sentence=sentence)]


def _mass(model: MeasurementModel, parameters: FloatArray) -> float:
    """Mass of the robot [kg] from an estimate."""
    nominal = model.nominal_inertias[::10]
    described = model.robot.weight / float(np.linalg.norm(model.robot.gravity))
    return described + float(np.sum(parameters[: 10 * len(nominal) : 10] - nominal))


def _crossing(vectors: FloatArray) -> FloatArray:
    """Matrices ``(N, 3, 3)`` of cross products with ``vectors (N, 3)``."""
    return np.asarray(np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1))


_SHIFTS = STEP * np.arange(-10, 11)  # [ns]
_TURNED_BY_LEGS = np.radians(10.0)  # encoder zeros, and rolling feet, cause a few degrees


def gyroscope(legs: Legs, stretch: Samples) -> list[Cause]:
    """Report a fault of the base's gyroscope, if both halves of a ``stretch`` on all feet show it."""
    measured, seconds = stretch.base_velocity[:, 3:], stretch.seconds
    turning = legs.base_rate(stretch)
    usable = np.flatnonzero(_interior(stretch) & np.isfinite(turning).all(axis=1))
    if len(usable) < 2 * FEWEST:
        return []
    moved = np.array(
        [[np.interp(seconds[usable] + 1e-9 * shift, seconds, axis) for axis in measured.T] for shift in _SHIFTS]
    ).transpose(0, 2, 1)
    parts = [(turning[usable[half]], moved[:, half]) for half in np.array_split(np.arange(len(usable)), 2)]
    if not all(np.any(by_legs) and np.all(np.any(shifted, axis=(1, 2))) for by_legs, shifted in parts):
        return []  # they can be compared only where both measure a rotation
    late, angle, ratio, before, after = np.array([_compared(*part) for part in parts]).T
    if np.any(after > MOST * np.minimum(before, MOST)):
        return []
    off = 1e9 * abs(float(np.mean(late)))
    if np.all(ratio < MOST) or np.all(ratio > 1.0 / MOST):
        fault = f"it measures {np.mean(ratio):.3g} times that rotation: publish it in rad/s"
    elif off > STEP and np.ptp(late) < MOST * abs(np.mean(late)):
        word = ("late" if np.mean(late) > 0.0 else "early") + (" or more" if off > _SHIFTS[-2] else "")
        fault = f"its stamps are {1e-6 * off:.0f} ms {word}: synchronise its clock with that of the joints"
    elif np.mean(angle) > _TURNED_BY_LEGS and np.ptp(angle) < MOST * np.mean(angle):
        degrees = np.degrees(np.mean(angle))
        fault = f"it is turned by about {degrees:.0f} degrees against its frame in the URDF: correct the frame"
    else:
        return []
    sentence = f"the gyroscope disagrees with the base rotation computed from the standing legs: {fault}"
    return [Cause(kind="imu", sentence=sentence)]


def on_all_feet(legs: Legs, samples: Samples) -> Samples:
    """Select the samples around which all feet support half of an equal share or more, as far as is known."""
    bearing = np.all(samples.standing, axis=1)
    bearing[bearing] = np.all(legs.loads(samples.select(bearing)) > MOST, axis=1)
    return samples.select(~within(samples.stamps, ~bearing[:, None], int(_SHIFTS[-1]))[:, 0])


def _interior(stretch: Samples) -> BoolArray:
    """True for the samples ``(N,)`` around which nothing is missing for any shift."""
    stamps = stretch.stamps
    runs = np.append(0, np.cumsum(np.diff(stamps) > 2 * STEP))
    ends = [np.clip(np.searchsorted(stamps, stamps + shift), 0, len(stamps) - 1) for shift in _SHIFTS[[0, -1]]]
    inside = (stamps + _SHIFTS[0] >= stamps[0]) & (stamps + _SHIFTS[-1] <= stamps[-1])
    return np.asarray(inside & np.all([runs[end] == runs for end in ends], axis=0))


def _compared(turning: FloatArray, moved: FloatArray) -> tuple[float, float, float, float, float]:
    """Compare the angular velocity from the legs ``(N, 3)`` with the gyroscope's at each shift ``(shifts, N, 3)``.

    Returns:
        The delay of the gyroscope's stamps [s]; the angle of its rotation against its frame [rad]; the size of what it
        measures over that of the legs; and the fraction of their squared angular velocity that it leaves, as it is and
        corrected.
    """
    square = float(np.sum(turning**2))
    fits = [best_rotation(turning.T @ shifted) for shifted in moved]
    residuals = np.array(
        [
            np.sum((turning - strength / float(np.sum(shifted**2)) * shifted @ axes.T) ** 2)
            for (axes, strength), shifted in zip(fits, moved, strict=True)
        ]
    )
    best = int(np.argmin(residuals))
    late = float(_SHIFTS[best])
    if 0 < best < len(residuals) - 1:
        before, middle, after = residuals[best - 1 : best + 2]
        late += STEP * 0.5 * (before - after) / (before - 2.0 * middle + after)
    as_it_is = float(np.sum((turning - moved[len(moved) // 2]) ** 2))
    (axes, strength), size = fits[best], float(np.sum(moved[best] ** 2))
    return 1e-9 * late, rotation_angle(axes), size / strength, as_it_is / square, float(residuals[best]) / square
