"""Efforts with the opposite sign, without one, or of each other's joints; friction of the opposite sign."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.evidence import LEAST_SIGMA
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.readings import Reading, World, as_it_is
from geomid_ros.checks.subject import Subject
from geomid_ros.types import FloatArray

_ROUNDS = 4
_NEARLY = 0.02  # of instants, and of the largest effort: what a filter leaves beyond zero
_BOTH = 0.1  # of instants at least: a prediction of both signs


def sign_hypotheses(subject: Subject, world: World) -> Iterator[Hypothesis]:
    """The efforts of all joints are reversed, or of one."""
    count = len(subject.joints)
    everywhere = as_it_is(count)
    cause = words.reversed_efforts(subject.names, subject.gains, True)
    found = world.judge(Reading(everywhere.sources, -everywhere.gains))
    yield subject.hypothesis(cause, found, 1, allowed=not np.any(world.opposite(found)))
    for joint in range(count) if count > 1 else ():
        gains = everywhere.gains.copy()
        gains[joint] = -1.0
        cause = words.reversed_efforts([subject.names[joint]], [subject.gains[joint]], False)
        found = world.judge(Reading(everywhere.sources, gains))
        upright = not world.opposite(found)[joint]
        yield subject.hypothesis(cause, found, count, concerned=[joint], allowed=upright)


def order_hypotheses(subject: Subject, world: World) -> Iterator[Hypothesis]:
    """The efforts of two joints are exchanged."""
    count = len(subject.joints)
    pairs = list(combinations(range(count), 2))
    for first, second in pairs:
        sources = np.arange(count)
        sources[[first, second]] = second, first
        cause = words.exchanged_efforts(subject.names[first], subject.names[second])
        found = world.judge(Reading(sources, np.ones(count)))
        yield subject.hypothesis(cause, found, len(pairs), sources=sources, concerned=[first, second])


def friction_hypotheses(subject: Subject, world: World) -> Iterator[Hypothesis]:
    """Weights and inertias are in the efforts as they should be, but friction drives joints."""
    found = world.judge(as_it_is(len(subject.joints)), either_sign=True)
    friction = world.friction(found)
    velocity = subject.samples.velocity[:, subject.joints]
    drives = (np.mean(friction * velocity, axis=0) < 0.0) & (np.sqrt(np.mean(friction**2, axis=0)) > LEAST_SIGMA)
    concerned = np.flatnonzero(drives).tolist()
    if concerned and not np.any(world.opposite(found)):
        cause = words.overcompensated([subject.names[joint] for joint in concerned])
        yield subject.hypothesis(cause, found, 1, concerned=concerned)


def magnitude_hypotheses(subject: Subject, world: World) -> Iterator[Hypothesis]:
    """Efforts are the magnitudes of what they should be: those that never change their sign where what is predicted, or
    the velocity of a joint that mainly rubs, does."""
    efforts = subject.efforts(subject.samples)
    concerned, signs = _without_sign(efforts.measured, world.predicted, subject.samples.velocity[:, subject.joints])
    if not len(concerned):
        return
    reading = as_it_is(len(subject.joints))
    for _ in range(_ROUNDS):
        measured = efforts.measured.copy()
        measured[:, concerned] = signs * np.abs(measured[:, concerned])
        signed = World(replace(efforts, measured=measured), subject.regressor(subject.samples))
        found = signed.judge(reading)
        signs = np.sign(signed.explained(found)[:, concerned])
    cause = words.magnitudes([subject.names[joint] for joint in concerned])
    yield subject.hypothesis(cause, found, 2 ** len(concerned), concerned=concerned)


def _without_sign(measured: FloatArray, predicted: FloatArray, velocity: FloatArray) -> tuple[list[int], FloatArray]:
    """The channels that have lost their sign, and the signs ``(N, k)`` that they may have had."""
    concerned, signs = [], []
    for channel, effort in enumerate(measured.T):
        low, high = np.quantile(effort, (_NEARLY, 1.0 - _NEARLY))
        if min(-low, high) > _NEARLY * max(-low, high):
            continue
        alike = [(_alike(effort, expected), expected) for expected in (predicted[:, channel], velocity[:, channel])]
        expected = max(alike, key=lambda pair: pair[0])[1]
        if _BOTH < np.mean(expected > 0.0) < 1.0 - _BOTH:
            concerned.append(channel)
            signs.append(np.sign(expected))
    return concerned, np.array(signs).T


def _alike(effort: FloatArray, expected: FloatArray) -> float:
    """The correlation of an effort's magnitude with that of what is expected."""
    return float(np.nan_to_num(np.corrcoef(np.abs(effort), np.abs(expected))[0, 1]))
