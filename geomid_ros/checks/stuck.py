"""Channels that repeat one value for a while: an effort, or a position, that is not measured there."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.causes import Cause
from geomid_ros.checks.evidence import LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.subject import Subject
from geomid_ros.estimation.estimate import SURE
from geomid_ros.types import BoolArray, FloatArray

_SAME = 1e-6  # of a range: what changes less stays exactly the same
_FEWEST = 5  # instants in a row, and at the ends of a stretch, where a filter smears the step that follows


def held_efforts(subject: Subject) -> list[Cause]:
    """The efforts that stay the same for a while in which gravity and motion ask for others."""
    found, rigid, stamps = [], subject.flexible.rigid, subject.samples.stamps
    for channel, effort in enumerate(subject.measured.T):
        changes = np.abs(np.diff(rigid[:, channel]))
        same = np.abs(np.diff(effort)) <= _SAME * np.ptp(effort)
        begins = np.flatnonzero(np.diff(same.astype(np.int8), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(same.astype(np.int8), append=0) == -1) + 1
        for begin, end in zip(begins, ends, strict=True):
            others = np.delete(same & (changes > LEAST_SIGMA * np.std(effort)), np.arange(begin, end))
            asked = float(np.ptp(rigid[begin : end + 1, channel]))
            if end - begin >= _FEWEST and np.mean(others) < LEAST_SIGMA and asked > np.std(effort):
                times = {name: (stamps[at] - stamps[0]) * 1e-9 for name, at in (("begin", begin), ("end", end))}
                found.append(Cause.of("constant", [subject.names[channel]], said="held", asked=asked, **times))
                break
    return found


def frozen_position(subject: Subject) -> Cause | None:
    """A joint whose position is exactly the same for a while, while others move and efforts are not those of that pose.

    The links are fitted to the other instants, and predict these. Where a joint really stands still, its brake holds it
    without any effort or its effort may be off by dry friction, and no other effort is off. A robot that stands still
    as a whole tells nothing.
    """
    positions, efforts = subject.samples.position, subject.measured
    for joint, position in enumerate(positions.T):
        same = np.abs(np.diff(position)) <= _SAME * np.ptp(position)
        still = np.append(False, same) & np.append(same, False) & subject.is_moving  # filters smear the ends
        if np.count_nonzero(still) >= _FEWEST and np.count_nonzero(~still) >= FEWEST + 2 * _FEWEST:
            changes = np.ptp(efforts[still], axis=0) > LEAST_SIGMA * np.ptp(efforts, axis=0)
            inside, outside = _left(subject, still)
            surely = np.sqrt(1.0 + SURE * np.sqrt(2.0 / np.count_nonzero(still)))  # of the mean of so many squares
            moving = np.ptp(positions[still], axis=0) > LEAST_SIGMA * np.ptp(positions, axis=0)
            if np.any(moving) and np.any((inside > surely * outside) & changes):
                return Cause.of("frozen", [subject.robot.joint_names[joint]], share=np.mean(still))
    return None


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
