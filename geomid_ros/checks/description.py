"""Descriptions that can be no robot's, whatever was measured: lengths, masses or inertias in another unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomid_ros.checks.candidates import REASON
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.efforts import STANDARD_GRAVITY
from geomid_ros.checks.subject import Subject
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray


def impossible_description(subject: Subject) -> Cause | None:
    """What is wrong with the URDF, whatever was measured: lengths, centres of mass and radii of gyration that are not
    of one robot, masses that joints of such limits could not carry, or that no steel could have."""
    robot = subject.robot
    bodies = np.array([body.parameters for body in robot.bodies])
    distances = np.linalg.norm(bodies[:, 1:4], axis=1) / bodies[:, 0]
    radii = np.sqrt([0.5 * np.trace(pseudo_inertia.central_inertia(body)) / body[0] for body in bodies])
    length, total = _length(subject), float(np.sum(bodies[:, 0]))
    whole = f"though all links together are {length:.3g} m long"
    weighs = f"the links weigh {total:.3g} kg in total, and "
    if np.median(_denser_than_steel(bodies)) > 0.0:
        return _lengths([], f"{weighs}most of its links would be denser than steel", "the masses", "grams", "kg")
    for sizes, what, quantity, unit, right in (
        (distances, "the centre of mass of link '{}' is {:.3g} m from its frame", "centres of mass", "mm", "m"),
        (radii, "the moments of inertia of link '{}' are those of mass {:.3g} m away from its centre",
         "moments of inertia", "g mm^2 or kg mm^2", "kg m^2"),
    ):  # fmt: skip
        most = int(np.argmax(sizes))
        if 0.0 < REASON**2 * length < sizes[most]:
            said = f"{what.format(robot.body_names[most], sizes[most])}, {whole}"
            return _lengths([robot.body_names[most]], said, quantity, unit, right)
    if length > REASON**2 * float(np.sum(radii)) > 0.0:
        said = f"all links together are {length:.3g} m long, though their mass is within {np.max(radii):.3g} m"
        return _lengths([], said, "the origins of joints", "mm", "m")
    with np.errstate(divide="ignore"):
        excess = _weights(subject) / robot.effort_limits
    joint = int(np.argmax(excess))
    if excess[joint] > REASON**2:
        said = f"{weighs}joint '{robot.joint_names[joint]}' would carry {excess[joint]:.0f} times its limit"
        return _lengths([], said, "the masses", "grams", "kg")
    return None


def _lengths(links: list[str], what: str, quantity: str, unit: str, right: str) -> Cause:
    return Cause.of("description", links, said="lengths", what=what, quantity=quantity, unit=unit, right=right)


def _length(subject: Subject) -> float:
    """The sum of all distances from a joint to the next, where all positions are zero."""
    robot, first = subject.robot, subject.samples.select(slice(1))
    frames = robot.link_frames(replace(first, position=np.zeros_like(first.position)))
    return float(sum(np.linalg.norm(frames[j.child][1] - frames[j.parent][1]) for j in robot.tree.joints))


def _weights(subject: Subject) -> FloatArray:
    """The largest efforts of the URDF's links at rest where the robot was, within its limits, whatever gravity is said
    to be ``(joints,)``."""
    samples, gravity, weights = subject.samples, subject.robot.gravity, np.zeros(len(subject.robot.joints))
    within = replace(samples, position=np.clip(samples.position, *subject.robot.position_limits.T))
    on_earth = STANDARD_GRAVITY / max(float(np.linalg.norm(gravity)), STANDARD_GRAVITY)
    weights[subject.joints] = on_earth * np.max(np.abs(subject.with_samples(within).weight), axis=0)
    return weights


def _denser_than_steel(bodies: FloatArray) -> BoolArray:
    """Whether bodies ``(B, 10)`` are smaller than steel balls of their masses."""
    traces = [np.trace(pseudo_inertia.central_inertia(body)) for body in bodies]  # twice that of the second moments
    least = [6.0 * body[0] * pseudo_inertia.least_gyration(body[0]) ** 2 for body in bodies]
    return np.asarray(np.array(traces) < np.array(least))
