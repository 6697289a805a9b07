"""Efforts by set-points: what acts is the command that holds, in whichever blocks the messages come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.model.controller import PDController
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .feeding import (
    JOINTS,
    START,
    Motion,
    blocks,
    feed,
    in_time,
    jittered,
    joint_messages,
    pipeline_of,
    regular,
    seconds,
)
from .sent import CommandMessage, JointMessage, Message

KP, KD = np.array([50.0, 80.0, 20.0]), np.array([1.0, 0.0, 3.0])
STAMPS = regular(0.01, 8.0)
HOLD = 0.02  # [s]


def controlled(delay: float = 0.0, cutoff: float = 5.0) -> SignalPipeline:
    return pipeline_of(
        JOINTS, settings=SignalSettings(cutoff=cutoff), controller=PDController(KP, KD, round(1e9 * delay))
    )


def set_points(stamps: IntArray) -> FloatArray:
    """Of positions ``(N, joints)``."""
    return Motion().derivative(stamps, 0) + 0.1 * np.sin(seconds(stamps))[:, None]


def commands(stamps: IntArray, ahead: float = 0.0, forward: float = 0.0) -> list[Message]:
    """Set-points, sent some seconds ``ahead``, the joints in another order."""
    none, wanted = np.zeros(0), set_points(stamps)
    effort = np.full(3, forward) if forward else none
    sent = stamps - round(1e9 * ahead)
    return [
        CommandMessage(int(stamp), JOINTS[::-1], row[::-1], none, effort)
        for stamp, row in zip(sent, wanted, strict=True)
    ]


def states(*, efforts: bool = False) -> list[JointMessage]:
    measured = joint_messages(STAMPS, velocity=True)
    if efforts:
        return list(measured)
    return [JointMessage(m.stamp, m.names, m.position, m.velocity, ()) for m in measured]


def with_velocities(change: Callable[[FloatArray], FloatArray], sent: list[Message] | None = None) -> list[Message]:
    """States and commands, the states' velocities changed."""
    changed = [replace(message, velocity=change(message.velocity)) for message in states()]
    return in_time(changed, sent or commands(regular(HOLD, 8.0)))


def expected(stamps: IntArray, late: float) -> FloatArray:
    """Efforts of set-points that act ``late`` [s], before the filter, which hardly changes them."""
    motion = Motion()
    wanted = set_points(stamps - round(1e9 * late))
    return KP * (wanted - motion.derivative(stamps, 0)) - KD * motion.derivative(stamps, 1)


@pytest.mark.parametrize("period", [0.002, 0.04])
def test_a_command_holds_until_the_next_one(period: float) -> None:
    """On average it is half of the time between commands old."""
    found = feed(controlled(), in_time(states(), commands(regular(period, 8.0))))
    np.testing.assert_allclose(found.effort, expected(found.stamps, 0.5 * period), atol=0.1)
    off = np.abs(found.effort - expected(found.stamps, 0.0))
    assert period < 0.04 or np.max(off) > 0.5


def test_the_delay_moves_commands() -> None:
    found = feed(controlled(delay=0.05), in_time(states(), commands(regular(HOLD, 8.0), ahead=0.05)))
    np.testing.assert_allclose(found.effort, expected(found.stamps, 0.5 * HOLD), atol=0.05)


def test_feed_forward_adds_and_reported_efforts_are_kept() -> None:
    plain, more = (
        feed(controlled(), in_time(states(efforts=True), commands(regular(HOLD, 8.0), forward=own)))
        for own in (0.0, 1.5)
    )
    np.testing.assert_allclose(more.effort - plain.effort, 1.5, atol=1e-9)
    np.testing.assert_allclose(more.commands[:, 3], Motion().effort(more.stamps), atol=0.05)
    assert plain.commands.shape == (len(plain), 4, 3)


def test_blocks_of_any_size_make_the_same_samples() -> None:
    noise = np.random.default_rng(1)  # so much that first samples are not told from another kind of velocity
    sent = commands(jittered(0.0015, 2.0))
    messages = with_velocities(lambda v: v + noise.normal(scale=5.0, size=3), sent)[: 3 * len(sent) // 2]
    one, many = controlled(), controlled()
    for message in messages:
        one.push(message)
    for begin in range(0, len(messages), 70):
        many.push(blocks(messages[begin : begin + 70]))
    found = [each.collect() for each in (one, many)]
    assert found[0] is not None
    assert found[1] is not None
    np.testing.assert_array_equal(found[0].effort, found[1].effort)


def test_the_controller_acts_on_the_velocities_that_are_sent() -> None:
    """Their noise is in the motors' efforts, and not in the motion of samples."""
    noise = np.random.default_rng(0)
    noisy, smooth = (
        feed(controlled(cutoff=20.0), with_velocities(lambda v, size=size: v + noise.normal(scale=size, size=3)))
        for size in (0.3, 0.0)
    )
    spread = np.std(noisy.effort - smooth.effort, axis=0)
    np.testing.assert_allclose(spread, KD * spread[0] / KD[0], rtol=0.3)
    assert 0.1 < spread[0] / KD[0] < 0.3
    np.testing.assert_array_equal(noisy.velocity, smooth.velocity)


@pytest.mark.parametrize("factor", [-1.0, 0.8])
def test_velocities_of_another_kind_are_not_acted_on(factor: float) -> None:
    wrong, right = (feed(controlled(), with_velocities(lambda v, by=by: by * v)) for by in (factor, 1.0))
    half = len(right) // 2  # by then a small factor is told
    np.testing.assert_allclose(wrong.effort[half:], right.effort[half:], atol=0.02)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (CommandMessage(START, JOINTS[:2], np.zeros(2), np.zeros(0), np.zeros(0)), "joint 'wrist' is missing"),
        (CommandMessage(START, JOINTS, np.full(3, np.nan), np.zeros(0), np.zeros(0)), "command not finite"),
        (CommandMessage(START, JOINTS, np.zeros(0), np.zeros(0), np.ones(3)), "a command of 0 numbers for 3 names"),
    ],
)
def test_commands_that_say_too_little_are_counted(message: CommandMessage, reason: str) -> None:
    pipeline = controlled()
    pipeline.push(message)
    pipeline.release()
    (told,) = pipeline.ledger.topics["joint_commands"].rejected
    assert reason in str(told)
