"""The message's velocity is used where it is the derivative of the position, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.model.samples import Samples
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.velocity_choice import SCALED
from geomid_ros.types import FloatArray

from .feeding import JOINTS, Motion, assert_same, feed, joint_messages, regular, seconds

STAMPS = regular(0.01, 10.0)
SETTINGS = SignalSettings(period=0.01)
WARM_UP = 100  # samples that are seen before a velocity is believed


def fed(velocity: FloatArray | None) -> Samples:
    """Samples of the motion with these velocities ``(N, joints)`` in the messages."""
    messages = joint_messages(STAMPS)
    if velocity is not None:
        messages = [replace(message, velocity=row) for message, row in zip(messages, velocity, strict=True)]
    return feed(SignalPipeline(JOINTS, settings=SETTINGS), messages)


@cache
def derivatives() -> Samples:
    """Samples of the motion without velocities in the messages."""
    return fed(None)


def true_velocity() -> FloatArray:
    return Motion().derivative(STAMPS, 1)


def marked() -> FloatArray:
    """A good velocity that can be told from the derivative: 1 % of another sine is added."""
    return true_velocity() + 0.01 * np.sin(2.0 * np.pi * 0.37 * seconds(STAMPS))[:, None]


WRONG = {
    "NaN": lambda v: np.full_like(v, np.nan),
    "twice": lambda v: 2.0 * v,
    "half": lambda v: 0.5 * v,
    "reversed": lambda v: -v,
    "zero": np.zeros_like,
    "in degrees": np.rad2deg,
    "late by a tenth of a second": lambda v: np.roll(v, 10, axis=0),
    "late by a hundredth of a second": lambda v: np.roll(v, 1, axis=0),
    "an offset": lambda v: v + 0.5,
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_velocity_is_not_used(case: str) -> None:
    assert_same(fed(WRONG[case](true_velocity())), derivatives(), tolerance=0.0)


@pytest.mark.parametrize(
    ("factor", "noted"),
    [(1.0, False), (1.02, False), (1.1, True), (0.714, True), (-1.0, False), (2.0, False), (0.5, False)],
)
def test_velocities_in_another_unit_of_time_are_told(factor: float, noted: bool) -> None:
    """As are stamps that run too fast; a joint that is reversed, or a clock off by half, is another fault."""
    velocity = factor * true_velocity()
    messages = [replace(m, velocity=row) for m, row in zip(joint_messages(STAMPS), velocity, strict=True)]
    target = SignalPipeline(JOINTS, settings=SETTINGS)
    feed(target, messages)
    assert (SCALED in target.ledger.topics[JOINT_STATES].noted) == noted


def test_a_good_velocity_is_used() -> None:
    """After the warm-up it and its derivative are the samples; before, the position's derivatives."""
    samples, derived = fed(marked()), derivatives()
    positions_instead = [replace(m, position=v) for m, v in zip(joint_messages(STAMPS), marked(), strict=True)]
    given = feed(SignalPipeline(JOINTS, settings=SETTINGS), positions_instead)
    for kind, source in (("velocity", "position"), ("acceleration", "velocity")):
        np.testing.assert_allclose(
            getattr(samples, kind)[WARM_UP:], getattr(given, source)[WARM_UP:], rtol=0, atol=1e-12
        )
        before = slice(WARM_UP - 1)
        np.testing.assert_array_equal(getattr(samples, kind)[before], getattr(derived, kind)[before])
    np.testing.assert_array_equal(samples.position, derived.position)


def test_each_joint_is_judged_alone() -> None:
    velocity = marked()
    velocity[:, 0] *= 2.0
    velocity[:, 2] = np.nan
    samples, derived, good = fed(velocity), derivatives(), fed(marked())
    for kind in ("velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(samples, kind)[:, [0, 2]], getattr(derived, kind)[:, [0, 2]])
        np.testing.assert_array_equal(getattr(samples, kind)[:, 1], getattr(good, kind)[:, 1])


def test_a_velocity_that_turns_bad_is_given_up() -> None:
    """From the middle on it is twice what it should be: the last samples are the derivative again."""
    velocity = marked()
    velocity[len(STAMPS) // 2 :] *= 2.0
    samples, derived = fed(velocity), derivatives()
    np.testing.assert_array_equal(samples.velocity[-100:], derived.velocity[-100:])
    middle = len(samples) // 2 - 15
    assert np.all(samples.velocity[middle] != derived.velocity[middle])


def test_a_velocity_missing_for_a_moment_is_derived_for_that_moment() -> None:
    velocity = marked()
    velocity[600, 1] = np.nan
    samples, derived, good = fed(velocity), derivatives(), fed(marked())
    near = np.abs(samples.stamps - STAMPS[600]) < 0.4e9
    np.testing.assert_array_equal(samples.velocity[near, 1], derived.velocity[near, 1])
    np.testing.assert_array_equal(samples.velocity[:, [0, 2]], good.velocity[:, [0, 2]])
    assert np.all(np.isfinite(samples.velocity))


def test_standing_still_is_no_reason_to_doubt() -> None:
    """The motion stops for good after half the time; velocities stay what they were."""
    half = len(STAMPS) // 2
    position, velocity = Motion().derivative(STAMPS, 0), true_velocity()
    position[half:], velocity[half:] = position[half], 0.0
    rows = zip(joint_messages(STAMPS), position, velocity, strict=True)
    messages = [replace(message, position=p, velocity=v) for message, p, v in rows]
    samples = feed(SignalPipeline(JOINTS, settings=SETTINGS), messages)
    np.testing.assert_allclose(samples.velocity[-100:], 0.0, rtol=0, atol=1e-9)
