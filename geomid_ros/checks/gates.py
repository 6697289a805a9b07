"""What is seen without comparing hypotheses: descriptions that no robot has, efforts and positions that stand still."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.evidence import LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.transforms import REASON, STANDARD_GRAVITY
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import BoolArray, FloatArray

_FARTHEST = 10.0  # between lengths, distances and radii of one robot: in mm it is a hundred times as much or more
_SAME = 1e-6  # of a range: what changes less stays exactly the same
_FEWEST = (
    5  # instants in a row; and at the ends of a stretch, at which a filter makes a motion of the step that follows
)
_STILL, _PART = 0.01, 0.1  # of a range that nothing changes by; and that something changes by
_FAR = 2.0  # times what is left at other instants


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
        if 0.0 < _FARTHEST * length < sizes[most]:
            said = f"{what.format(robot.body_names[most], sizes[most])}, {whole}"
            return _lengths([robot.body_names[most]], said, quantity, unit, right)
    if length > _FARTHEST * float(np.sum(radii)) > 0.0:
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
    """The sum of all distances from a joint to the next."""
    robot = subject.robot
    frames = robot.link_frames(subject.samples.select(slice(1)))
    return float(sum(np.linalg.norm(frames[j.child][1] - frames[j.parent][1]) for j in robot.tree.joints))


def _weights(subject: Subject) -> FloatArray:
    """The largest efforts of the URDF's links at rest where the robot was, whatever gravity is said to be
    ``(joints,)``."""
    gravity, weights = subject.robot.gravity, np.zeros(len(subject.robot.joints))
    on_earth = STANDARD_GRAVITY / max(float(np.linalg.norm(gravity)), STANDARD_GRAVITY)
    weights[subject.joints] = on_earth * np.max(np.abs(subject.weight), axis=0)
    return weights


def _denser_than_steel(bodies: FloatArray) -> BoolArray:
    """Whether bodies ``(B, 10)`` are smaller than steel balls of their masses."""
    traces = [np.trace(pseudo_inertia.central_inertia(body)) for body in bodies]  # twice that of the second moments
    least = [6.0 * body[0] * pseudo_inertia.least_gyration(body[0]) ** 2 for body in bodies]
    return np.asarray(np.array(traces) < np.array(least))


def held_efforts(subject: Subject) -> list[Cause]:
    """The efforts that stay the same for a while in which gravity and motion ask for others."""
    found, rigid, stamps = [], subject.flexible.rigid, subject.samples.stamps
    for channel, effort in enumerate(subject.measured.T):
        changes = np.abs(np.diff(rigid[:, channel]))
        same = np.abs(np.diff(effort)) <= _SAME * np.ptp(effort)
        begins = np.flatnonzero(np.diff(same.astype(np.int8), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(same.astype(np.int8), append=0) == -1) + 1
        for begin, end in zip(begins, ends, strict=True):
            others = np.delete(same & (changes > _STILL * np.std(effort)), np.arange(begin, end))
            asked = float(np.ptp(rigid[begin : end + 1, channel]))
            if end - begin >= _FEWEST and np.mean(others) < _PART and asked > np.std(effort):
                times = {name: (stamps[at] - stamps[0]) * 1e-9 for name, at in (("begin", begin), ("end", end))}
                found.append(Cause.of("constant", [subject.names[channel]], said="held", asked=asked, **times))
                break
    return found


def is_model(subject: Subject) -> bool:
    """Whether efforts are what the URDF predicts: without friction, without any error."""
    left = np.sqrt(np.mean((subject.measured - subject.predicted) ** 2, axis=0))
    return bool(np.all(left < 0.5 * LEAST_SIGMA * subject.spread))


def frozen_position(subject: Subject) -> Cause | None:
    """A joint whose position stands exactly still for long, while others move and efforts are not those of that pose.

    The links are fitted to the other instants, and predict these. Where a joint really stands still, its brake holds it
    without any effort or its effort may be off by dry friction, and no other effort is off. A robot that stands still
    as a whole tells nothing.
    """
    positions, efforts = subject.samples.position, subject.measured
    for joint, position in enumerate(positions.T):
        still = _longest_still(position)
        if _PART < np.mean(still) < 0.5 and np.count_nonzero(~still) >= FEWEST + 2 * _FEWEST:
            changes = np.ptp(efforts[still], axis=0) > _PART * np.ptp(efforts, axis=0)
            inside, outside = _left(subject, still)
            moving = np.ptp(positions[still], axis=0) > _PART * np.ptp(positions, axis=0)
            if np.any(moving) and np.any((inside > _FAR * outside) & changes):
                return Cause.of("frozen", [subject.robot.joint_names[joint]], share=np.mean(still))
    return None


def _longest_still(position: FloatArray) -> BoolArray:
    """The instants ``(N,)`` of the longest stretch without any motion, less its ends, which filters smear."""
    moves = np.flatnonzero(np.abs(np.diff(position)) > _SAME * np.ptp(position))
    ends = np.concatenate([[-1], moves, [len(position) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    still = np.zeros(len(position), dtype=bool)
    still[ends[longest] + 2 : ends[longest + 1]] = True
    return still


def _left(subject: Subject, still: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The RMS of what links and friction, fitted to the other instants, leave of efforts beyond dry friction: at these
    instants, and at the others ``(C,)``."""
    smeared = np.convolve(still, np.ones(2 * _FEWEST + 1), mode="same") > 0.0
    others = subject.part(~smeared)
    found = others.nominal
    left = (subject.measured - subject.regressor @ others.links(found)) / others.spread
    left -= np.einsum("nck,ck->nc", subject.friction, found.friction)
    beyond = np.maximum(np.abs(left) - np.where(still[:, None], found.friction[:, 2], 0.0), 0.0)
    inside, outside = (np.sqrt(np.mean(beyond[chosen] ** 2, axis=0)) for chosen in (still, ~smeared))
    return inside, np.maximum(outside, found.sigmas)
