"""What goes wrong beside a real robot: every message is accounted for, and the bad ones leave no trace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.signals.message_batch import MISSING_JOINT_ADVICE
from geomid_ros.signals.messages import AcceptedMessages
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings

from .feeding import (
    JOINTS,
    START,
    assert_same,
    balanced,
    feed,
    in_time,
    joint_messages,
    pipeline_of,
    regular,
    without,
    wrench_messages,
)
from .sent import JointMessage, Message, PoseMessage, WrenchMessage

SENSOR = WrenchSensor("/wrench", "tool", "mounted", ("fx", "fz"))
EVERY = 7  # each seventh message is followed by a bad one
NAN, INFINITY = float("nan"), float("inf")


def pipeline(period: float = 0.01) -> SignalPipeline:
    return pipeline_of(JOINTS, sensors=[SENSOR], settings=SignalSettings(period=period), floating_base=True)


def poses() -> list[PoseMessage]:
    """The base turns and drifts."""
    stamps = regular(0.02, 3.5)
    angles = 0.3 * np.sin(np.arange(len(stamps)) * 0.02)
    rows = np.column_stack([angles, -angles, angles**2, np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)])
    return [PoseMessage(int(stamp), row) for stamp, row in zip(stamps, rows, strict=True)]


@cache
def clean() -> tuple[Message, ...]:
    """Long enough for the messages' velocities to be used at the end."""
    joints, wrenches = joint_messages(regular(0.01, 3.5), velocity=True), wrench_messages(regular(0.004, 3.5))
    return tuple(in_time(joints, wrenches, poses()))


@cache
def expected(period: float = 0.01) -> Samples:
    """The samples of the clean messages."""
    return feed(pipeline(period), clean())


def entry(message: Message, key: str, place: int, value: float) -> Message:
    """The message with another number in one place."""
    values = np.array(getattr(message, key), dtype=float)
    values[place] = value
    return replace(message, **{key: values})


def soon(message: Message) -> Message:
    """The message a little later, between two others."""
    return replace(message, stamp=message.stamp + 100_000)


UNSTAMPED = "stamp is zero: whoever publishes has to fill in header.stamp"
PREFIXED = "the messages' names have the prefix 'left_'. Give the URDF with it (tf_prefix)"
REPEATED = "stamp not later than the one before"
BAD: dict[type[Message], list[tuple[Callable[[Any], Message], str]]] = {
    JointMessage: [
        (lambda m: replace(m, stamp=0), UNSTAMPED),
        (lambda m: replace(m, stamp=-1), "stamp is not valid"),
        (lambda m: m, REPEATED),
        (lambda m: entry(m, "position", 0, 9.0), REPEATED),
        (lambda m: replace(m, stamp=m.stamp - 15_000_000), REPEATED),
        (lambda m: replace(m, stamp=m.stamp - 3_000_000_000), "stamp too old"),
        (lambda m: replace(m, stamp=m.stamp + 3_000_000_000), "stamp from the future"),
        (lambda m: entry(soon(m), "position", 1, NAN), "position of 'elbow' not finite"),
        (lambda m: entry(soon(m), "position", 1, 1e308), "position of 'elbow' not finite"),
        (lambda m: entry(soon(m), "velocity", 0, -1e308), "velocity of 'shoulder' not finite"),
        (lambda m: entry(soon(m), "effort", 2, NAN), "effort of 'wrist' missing or not finite"),
        (lambda m: entry(soon(m), "effort", 0, INFINITY), "effort of 'shoulder' missing or not finite"),
        (lambda m: replace(soon(m), effort=()), "driver error: no effort of 'shoulder' or any other joint"),
        (lambda m: without(soon(m), "elbow"), f"joint 'elbow' is missing: {MISSING_JOINT_ADVICE}"),
        (
            lambda m: replace(soon(m), names=tuple(f"left_{n}" for n in m.names)),
            f"joint 'shoulder' is missing: {PREFIXED}",
        ),
        (lambda m: replace(soon(m), names=(), position=(), velocity=(), effort=()), "driver error: no joint names"),
        (lambda m: replace(soon(m), names=("a", "b", "b")), "driver error: joint 'b' is named twice"),
        (lambda m: replace(soon(m), position=m.position[:2]), "driver error: position has 2 entries for 3 names"),
        (lambda m: replace(soon(m), velocity=[0.0] * 4), "driver error: velocity has 4 entries for 3 names"),
        (lambda m: replace(soon(m), effort=m.effort[:1]), "driver error: effort has 1 entries for 3 names"),
    ],
    WrenchMessage: [
        (lambda m: replace(m, stamp=0), UNSTAMPED),
        (lambda m: m, REPEATED),
        (lambda m: entry(soon(m), "wrench", 2, NAN), "wrench not finite"),
        (lambda m: entry(soon(m), "wrench", 0, 1e308), "wrench not finite"),
        (lambda m: replace(soon(m), frame="base"), "frame 'base' is not the declared 'tool'"),
    ],
    PoseMessage: [
        (lambda m: replace(m, stamp=0), UNSTAMPED),
        (lambda m: entry(soon(m), "pose", 0, NAN), "pose not finite"),
        (lambda m: replace(soon(m), pose=[0.0] * 7), "quaternion is not of length 1"),
    ],
}


@pytest.mark.parametrize(("kind", "case"), [(kind, case) for kind, cases in BAD.items() for case in range(len(cases))])
def test_bad_messages_leave_no_trace(kind: type[Message], case: int) -> None:
    """Nor on the period, which is inferred where stamps are bad."""
    spoil, reason = BAD[kind][case]
    period = 0.0 if reason.startswith("stamp") else 0.01
    messages, topic, bad = list[Message](), "", 0
    for index, message in enumerate(clean()):
        messages.append(message)
        if isinstance(message, kind) and index > 10 and (index % EVERY == 0 or kind is not JointMessage):
            messages.append(spoil(message))
            topic, bad = message.topic, bad + 1
    troubled = pipeline(period)
    assert_same(feed(troubled, messages), expected(period), tolerance=1e-9)
    account = troubled.ledger.topics[topic]
    assert account.rejected == {reason: bad}
    assert account.accepted == sum(message.topic == topic for message in clean())
    assert sum(other.rejected.total() for other in troubled.ledger.topics.values()) == bad
    assert balanced(troubled, messages)


def test_extra_joints_are_passed_over() -> None:
    """A gripper in the same message, with a NaN of its own."""
    messages = []
    for message in clean():
        if isinstance(message, JointMessage):
            message = replace(  # noqa: PLW2901
                message,
                names=("finger", *message.names, "thumb"),
                **{key: [NAN, *getattr(message, key), 1e308] for key in ("position", "velocity", "effort")},
            )
        messages.append(message)
    extra = pipeline()
    assert_same(feed(extra, messages), expected(), tolerance=0.0)
    assert balanced(extra, messages)
    assert extra.ledger.topics["joint_states"].rejected == {}


def test_an_effort_that_never_was_leaves_only_its_own_equation_out() -> None:
    messages = [entry(m, "effort", 1, NAN) if isinstance(m, JointMessage) else m for m in clean()]
    deaf = pipeline()
    samples = feed(deaf, messages)
    assert np.all(np.isnan(samples.effort[:, 1]))
    np.testing.assert_array_equal(samples.effort[:, [0, 2]], expected().effort[:, [0, 2]])
    np.testing.assert_array_equal(samples.position, expected().position)
    assert deaf.ledger.topics["joint_states"].rejected == {}


def test_messages_behind_one_that_fails_are_counted() -> None:
    """A slow topic: the fourth message decides on the second, which fails; the last two may go on."""
    stamps = np.array([START + 2_000_000_000 * index for index in range(4)])

    def fail(accepted: AcceptedMessages) -> None:
        if accepted.stamps[0] == stamps[1]:
            raise ZeroDivisionError

    unlucky = pipeline_of(JOINTS, on_accepted=fail)
    messages = joint_messages(stamps)
    for message in messages[:3]:
        unlucky.push(message)
    with pytest.raises(ZeroDivisionError):
        unlucky.push(messages[3])
    account = unlucky.ledger.topics["joint_states"]
    assert (account.accepted, account.dropped) == (1, {"ZeroDivisionError while taking a message": 1})
    assert unlucky.waiting_count == 2
