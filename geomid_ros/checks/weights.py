"""Gravity in another direction, or not in the efforts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.readings import World, as_it_is
from geomid_ros.checks.rows import gravity_rows
from geomid_ros.checks.subject import Subject
from geomid_ros.types import FloatArray

_TILT = np.radians(25.0)
_DIRECTIONS = 20  # that gravity may well have


def gravity_hypotheses(subject: Subject) -> Iterator[Hypothesis]:
    """The directions of gravity that fit best, and that it is not in the efforts."""
    nominal = subject.robot.gravity
    size = float(np.linalg.norm(nominal))
    if size == 0.0:
        return
    efforts, reading = subject.efforts(subject.samples), as_it_is(len(subject.joints))
    still, by_gravity = (rows[..., subject.joints, :] for rows in gravity_rows(subject.robot, subject.samples))

    def world(gravity: FloatArray) -> World:
        return World(efforts, still + np.tensordot(gravity, by_gravity, 1))

    def turned(gravity: FloatArray) -> Hypothesis:
        angle = float(np.arccos(np.clip(gravity @ nominal / size**2, -1.0, 1.0)))
        if angle > _TILT:
            cause = words.other_gravity(gravity, subject.names)
        else:
            cause = words.not_level(gravity, angle, subject.names)
        return subject.hypothesis(cause, world(gravity).judge(reading), _DIRECTIONS, alone=angle > _TILT)

    fitted = efforts.fitted_gravity(still, by_gravity, efforts.prior)
    for start in (size, -size):
        direction = start * fitted / max(float(np.linalg.norm(fitted)), 1e-9)
        other = world(direction)
        links = efforts.prior + efforts.factor @ other.links(other.judge(reading).links)
        refined = efforts.fitted_gravity(still, by_gravity, links)
        yield turned(direction)
        yield turned(size * refined / max(float(np.linalg.norm(refined)), 1e-9))
    weightless = World(efforts, still + np.tensordot(nominal, by_gravity, 1), predicted=still @ efforts.prior)
    for without in (World(efforts, still), weightless):
        yield subject.hypothesis(words.no_gravity(subject.names), without.judge(reading), 2)
