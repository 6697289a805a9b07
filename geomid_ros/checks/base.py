"""Whether a base that moves is as declared: what its legs carry, and where its IMU is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.evidence import HALF
from geomid_ros.estimation.estimate import TOLD, Estimate
from geomid_ros.model.contacts import DIRECTIONS, Contact, Legs
from geomid_ros.model.effects import effect_class
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.signals.base import LIFTED
from geomid_ros.types import FloatArray

_USUAL = 0.5, 3.0  # shares of the URDF's weight: it may lack a payload
_TURNED = 1.0  # [deg]
_DISPLACED = 0.03  # [m]


def unnamed_feet(robot: Robot, legs: Legs, samples: Samples) -> tuple[Finding, ...]:
    """That limbs which no contact names carry the robot, too, if so; ``samples`` are any of a recording."""
    bearing = {}
    for tip in _unnamed_tips(robot, legs):
        shares = Legs(robot, [Contact(tip)]).carried(samples)
        if np.any(known := np.isfinite(shares)):
            bearing[tip] = float(np.mean(shares[known]))
    named = [f"{100.0 * share:.0f} % at '{tip}'" for tip, share in bearing.items() if share > LIFTED]
    if not named:
        return ()
    sentence = (
        f"limbs that no contact names seem to carry a part of the robot's weight: {', '.join(named)}. Name their feet "
        "(--contacts)"
    )
    return (Finding(cause=Cause(kind="legs", sentence=sentence)),)


def _unnamed_tips(robot: Robot, legs: Legs) -> list[str]:
    """The ends of other limbs of three joints or more: of the links that carry none, the farthest from the last
    joint."""
    named, tips = {robot.joint_names[joint] for joints in legs.joints for joint in joints}, dict[str, str]()
    for link in robot.tree.links:
        moving = [joint.name for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names]
        if robot.tree.children(link) or len(moving) < DIRECTIONS or named.intersection(moving):
            continue
        last = tips.get(moving[0], link)
        tips[moving[0]] = max(link, last, key=lambda tip: _reach(robot, tip))
    return list(tips.values())


def _reach(robot: Robot, link: str) -> float:
    """How far a link is from the joint that moves it [m]."""
    moved = next(joint.child for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names)
    return float(np.linalg.norm(robot.fixed_placement(link, moved)[:3, 3]))


def never_lifted(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """That legs stand in all that was fitted, in a sentence, if so: their own efforts then tell nothing."""
    if model.legs is None:
        return []
    names = model.robot.joint_names
    still = [
        contact.frame
        for contact, joints in zip(model.legs.contacts, model.legs.joints, strict=True)
        if not np.any(np.isfinite([estimate.rms[estimate.channels.index(names[joint])] for joint in joints]))
    ]
    if not still:
        return []
    sentence = (
        f"{', '.join(still)} never left the ground in what was fitted: of these legs only what the base feels is "
        "identified. Lift each leg and move it in the air for two seconds or more; if it was, that was held out "
        "(--hold-out 0 fits it, too)"
    )
    return [sentence]


def carried_weight(legs: Legs, samples: Samples) -> tuple[Finding, ...]:
    """That by the efforts of the legs the feet do not carry the robot, if so; ``samples`` are any of a recording."""
    shares = legs.carried(samples)
    shares = shares[np.isfinite(shares)]
    share = float(np.mean(shares)) if len(shares) else 1.0
    if _USUAL[0] <= share <= _USUAL[1]:
        return ()
    sentence = (
        f"by the efforts of their legs the feet carry {share:.2g} of the robot's weight on average, expected about 1: "
        "check that efforts are in N m with their sign (effort_gain, --gain), that all feet are named (contacts), and "
        "that the IMU's frame is not upside down"
    )
    return (Finding(cause=Cause(kind="legs", sentence=sentence)),)


def turned_imu(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """That the IMU is turned or biased, in a sentence, if it is so by more than a degree."""
    offsets = [effect for effect in estimate.effects if effect_class(effect.name).place == "base"]
    force = math.hypot(*(offset.value for offset in offsets))
    std = math.hypot(*(offset.std for offset in offsets))
    acceleration = force / _mass(model, estimate.parameters)
    angle = math.degrees(math.atan(acceleration / np.linalg.norm(model.robot.gravity)))
    if angle < _TURNED or force < TOLD * std:
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
    if distance < _DISPLACED or np.linalg.norm(places[0] - places[1]) > HALF * distance:
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
