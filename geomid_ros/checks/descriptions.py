"""Whether a robot description can be that of any robot: lengths, weights and joints that have to carry them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.hypotheses import Cause
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.units import REASON
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray

_FARTHEST = 10.0  # times all lengths together, of mass: in mm it is a hundred times as far or more
_HALF = 0.5


def impossible_description(subject: Subject) -> Cause | None:
    """What is wrong with the URDF, whatever was measured: centres of mass or radii of gyration far beyond the robot,
    masses that joints of such limits could not carry, or that no steel could have."""
    robot = subject.robot
    bodies = np.array([body.parameters for body in robot.bodies])
    total = float(np.sum(bodies[:, 0]))
    length = _length(subject)
    distances = np.linalg.norm(bodies[:, 1:4], axis=1) / bodies[:, 0]
    farthest = int(np.argmax(distances))
    if 0.0 < _FARTHEST * length < distances[farthest]:
        return words.far_centre(robot.body_names[farthest], float(distances[farthest]), length)
    radii = np.sqrt([0.5 * np.trace(pseudo_inertia.central_inertia(body)) / body[0] for body in bodies])
    widest = int(np.argmax(radii))
    if 0.0 < _FARTHEST * length < radii[widest]:
        return words.wide_inertia(robot.body_names[widest], float(radii[widest]), length)
    with np.errstate(divide="ignore"):
        excess = _weights(subject) / robot.effort_limits
    if np.max(excess) > REASON**2:
        joint = int(np.argmax(excess))
        name = robot.joint_names[joint]
        return words.too_heavy(total, f"joint '{name}' would carry {excess[joint]:.0f} times its limit")
    if np.mean(_denser_than_steel(bodies)) > _HALF:
        return words.too_heavy(total, "most of its links would be denser than steel")
    return None


def _length(subject: Subject) -> float:
    """The sum of all distances from a joint to the next."""
    robot = subject.robot
    frames = robot.link_frames(subject.samples.select(slice(1)))
    return float(sum(np.linalg.norm(frames[j.child][1] - frames[j.parent][1]) for j in robot.tree.joints))


def _weights(subject: Subject) -> FloatArray:
    """The largest efforts of the URDF's links at rest where the robot was ``(joints,)``."""
    still = np.zeros_like(subject.samples.velocity)
    efforts = subject.regressor(replace(subject.samples, velocity=still, acceleration=still)) @ subject.prior
    weights = np.zeros(len(subject.robot.joints))
    weights[subject.joints] = np.max(np.abs(efforts), axis=0)
    return weights


def _denser_than_steel(bodies: FloatArray) -> BoolArray:
    """Whether bodies ``(B, 10)`` are smaller than steel balls of their masses."""
    traces = [np.trace(pseudo_inertia.central_inertia(body)) for body in bodies]  # twice that of the second moments
    least = [6.0 * body[0] * pseudo_inertia.least_gyration(body[0]) ** 2 for body in bodies]
    return np.asarray(np.array(traces) < np.array(least))
