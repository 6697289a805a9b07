"""Positions that stand still though the joint does not: an encoder that is cut off, a driver that repeats itself."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.hypotheses import Cause
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.readings import as_it_is
from geomid_ros.checks.subject import Subject
from geomid_ros.types import BoolArray, FloatArray

_STILL = 1e-6  # of the joint's way
_LONG, _SHORT = 0.1, 0.5  # of all instants: a stretch that the others can judge
_SMEARED = 3  # instants at the ends, at which a filter makes a motion of the step that follows
_MOVING = 0.1  # of a joint's way, or of an effort's range
_FAR = 2.0  # times what is left at other instants


def frozen_position(subject: Subject) -> Cause | None:
    """A joint whose position stands exactly still for long, while others move and efforts are not those of that pose.

    The links are fitted to the other instants, and predict these. Where a joint really stands still, its brake holds it
    without any effort or its effort may be off by dry friction, and no other effort is off. A robot that stands still
    as a whole tells nothing.
    """
    positions, efforts = subject.samples.position, subject.samples.effort[:, subject.joints]
    for joint, position in enumerate(positions.T):
        still = _longest_still(position)
        if _LONG < np.mean(still) < _SHORT and np.count_nonzero(~still) >= FEWEST + 2 * _SMEARED:
            changes = np.ptp(efforts[still], axis=0) > _MOVING * np.ptp(efforts, axis=0)
            inside, outside = _left(subject, still)
            if np.any(_moving(positions, still)) and np.any((inside > _FAR * outside) & changes):
                return words.frozen_position(subject.robot.joint_names[joint], float(np.mean(still)))
    return None


def _moving(positions: FloatArray, chosen: BoolArray) -> BoolArray:
    """Which joints ``(joints,)`` move at the chosen instants."""
    return np.asarray(np.ptp(positions[chosen], axis=0) > _MOVING * np.ptp(positions, axis=0))


def _longest_still(position: FloatArray) -> BoolArray:
    """The instants ``(N,)`` of the longest stretch without any motion, less its ends, which filters smear."""
    moves = np.flatnonzero(np.abs(np.diff(position)) > _STILL * np.ptp(position))
    ends = np.concatenate([[-1], moves, [len(position) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    still = np.zeros(len(position), dtype=bool)
    still[ends[longest] + 2 : ends[longest + 1]] = True
    return still


def _left(subject: Subject, still: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The RMS of what links and friction, fitted to the other instants, leave of efforts beyond dry friction: at these
    instants, and at the others ``(C,)``."""
    smeared = np.convolve(still, np.ones(2 * _SMEARED + 1), mode="same") > 0.0
    world = subject.world(subject.samples.select(~smeared))
    found = world.judge(as_it_is(len(subject.joints)))
    links = subject.prior + subject.factor @ world.links(found.links)
    efforts = subject.efforts(subject.samples)
    left = (efforts.measured - subject.regressor(subject.samples) @ links) / world.spread
    left -= np.einsum("nck,ck->nc", efforts.friction, found.friction)
    beyond = np.maximum(np.abs(left) - np.where(still[:, None], found.friction[:, 2], 0.0), 0.0)
    inside, outside = (np.sqrt(np.mean(beyond[chosen] ** 2, axis=0)) for chosen in (still, ~smeared))
    return inside, np.maximum(outside, found.sigmas)
