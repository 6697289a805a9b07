"""Positions that are those of other joints, or in degrees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.names import exchanges_of_names
from geomid_ros.checks.readings import as_it_is
from geomid_ros.checks.subject import Subject

_DEGREE = np.pi / 180.0


def name_hypotheses(subject: Subject) -> Iterator[Hypothesis]:
    """Positions and efforts of one joint are those of another."""
    exchanges = exchanges_of_names(subject.names)
    for pairs in exchanges:
        sources = np.arange(len(subject.joints))
        for first, second in pairs:
            sources[[first, second]] = second, first
        order = np.arange(len(subject.robot.joints))
        order[subject.joints] = subject.joints[sources]
        world = subject.world(subject.samples.with_joints(order))
        firsts, seconds = ([subject.names[pair[end]] for pair in pairs] for end in (0, 1))
        yield subject.hypothesis(
            words.exchanged_names(firsts, seconds),
            world.judge(as_it_is(len(sources))),
            len(exchanges),
            sources=sources,
            concerned=[place for pair in pairs for place in pair],
        )


def degree_hypotheses(subject: Subject) -> Iterator[Hypothesis]:
    """Positions and speeds are in degrees; only where they are beyond limits, or a turn."""
    samples = subject.samples
    turning = np.array([joint.unit != "N" for joint in subject.robot.joints])
    low, high = subject.robot.position_limits.T
    beyond = np.any((samples.position < low - 0.5) | (samples.position > high + 0.5), axis=0)
    wide = np.max(np.abs(samples.position), axis=0) > 2.0 * np.pi
    if not np.any(turning & (beyond | wide)):
        return
    scale = np.where(turning, _DEGREE, 1.0)
    small = replace(
        samples,
        position=scale * samples.position,
        velocity=scale * samples.velocity,
        acceleration=scale * samples.acceleration,
    )
    yield subject.hypothesis(words.degrees(subject.names), subject.world(small).judge(as_it_is(len(subject.joints))), 1)
