"""Samples move by their positions; velocities of messages tell whether stamps and units are right."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.model.samples import Samples
from geomid_ros.signals.clocks import SCALED
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray

from .feeding import JOINTS, Motion, assert_same, feed, joint_messages, regular

STAMPS = regular(0.01, 10.0)
SETTINGS = SignalSettings(period=0.01)


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


VELOCITIES = {
    "right": lambda v: v,
    "twice": lambda v: 2.0 * v,
    "late by a hundredth of a second": lambda v: np.roll(v, 1, axis=0),
    "missing at a joint": lambda v: np.where(np.arange(v.shape[1]) == 1, np.nan, v),
}


@pytest.mark.parametrize("case", VELOCITIES)
def test_samples_move_by_their_positions(case: str) -> None:
    assert_same(fed(VELOCITIES[case](true_velocity())), derivatives(), tolerance=0.0)


@pytest.mark.parametrize(
    ("factor", "seconds", "noted"),
    [
        (1.0, 10.0, False),
        (1.02, 10.0, False),
        (1.1, 10.0, True),
        (1.1, 2.0, False),
        (0.714, 10.0, True),
        (-1.0, 10.0, False),
        (2.0, 10.0, False),
        (0.5, 10.0, False),
    ],
)
def test_velocities_in_another_unit_of_time_are_told(factor: float, seconds: float, noted: bool) -> None:
    """As are stamps that run too fast; a joint that is reversed, or a clock off by half, is another fault. As a motion
    begins, velocities that are late are less than the derivatives, too: so little tells nothing."""
    velocity = factor * true_velocity()
    messages = [replace(m, velocity=row) for m, row in zip(joint_messages(STAMPS), velocity, strict=True)]
    target = SignalPipeline(JOINTS, settings=SETTINGS)
    feed(target, messages[: round(100 * seconds)])
    assert (SCALED in target.ledger.topics[JOINT_STATES].noted) == noted


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_joint_that_stands_still_tells_nothing(rate: float) -> None:
    """What moves there is in the last digits; a clock is judged by the others."""
    still = np.arange(3) == 1
    small, factors = np.where(still, 1e-7, 1.0), np.where(still, 0.7, rate)
    messages = [
        replace(m, position=small * m.position, velocity=factors * small * row)
        for m, row in zip(joint_messages(STAMPS), true_velocity(), strict=True)
    ]
    target = SignalPipeline(JOINTS, settings=SETTINGS)
    feed(target, messages)
    noted = " ".join(map(str, target.ledger.topics[JOINT_STATES].noted))
    assert ("stamps run 2 times too fast" in noted) == (rate == 2.0)
    assert str(SCALED) not in noted
