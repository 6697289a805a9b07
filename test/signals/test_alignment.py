"""Topics of different rates come out at common instants, which do not depend on who listened when."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import IntArray

from .feeding import (
    JOINTS,
    START,
    assert_same,
    balanced,
    blocks,
    completed,
    feed,
    in_time,
    joint_messages,
    pipeline_of,
    regular,
    wrench_messages,
)
from .sent import Message

SENSOR = WrenchSensor("/wrench", "tool", "mounted")


def pipeline(period: float = 0.01, **settings: float) -> SignalPipeline:
    return pipeline_of(JOINTS, sensors=[SENSOR], settings=SignalSettings(period=period, **settings))


def common(samples: Samples, stamps: IntArray) -> Samples:
    """The samples at these instants."""
    return samples.select(np.isin(samples.stamps, stamps))


def test_the_period_is_that_of_the_joints() -> None:
    """The median of the first ones, so that a few lost messages do not matter; to ten microseconds."""
    stamps = regular(0.01, 6.0)
    lossy = np.delete(stamps + np.random.default_rng(1).integers(-3000, 3000, len(stamps)), [3, 4, 11, 25])
    alone = pipeline_of(JOINTS)
    samples = feed(alone, joint_messages(lossy))
    assert np.all(samples.stamps % 10_000_000 == 0)
    assert alone.lag == pytest.approx(pipeline_of(JOINTS, settings=SignalSettings(period=0.01)).lag)


def test_messages_that_only_repeat_others_are_said_to_make_joints_too_slow() -> None:
    """At 20 Hz, each measurement twice: what is known of the motion comes at 10 Hz."""
    twice = pipeline_of(JOINTS)
    messages = joint_messages(regular(0.05, 6.0))
    again = [
        message if index % 2 == 0 else replace(messages[index - 1], stamp=message.stamp)
        for index, message in enumerate(messages)
    ]
    with pytest.raises(InputError, match=r"at 10 Hz: .* Of the first 120 messages on joint_states 59 only repeat"):
        twice.push(blocks(again))


def test_who_waits_for_ever_for_joints_does_not_fill_the_memory() -> None:
    """A wrench topic alone: the oldest messages are given up and counted."""
    alone = pipeline(0.0)
    messages = wrench_messages(regular(0.001, 11.0))
    assert list(completed(alone, messages)) == []
    assert sum(map(len, alone._sampler._waiting)) == 10_000
    assert alone.ledger.topics["/wrench"].rejected == {"no joint states to go with": 1000}
    assert balanced(alone, messages)


def test_who_comes_first_where_topics_pause_changes_nothing() -> None:
    """Messages of one topic may come in any number before the other's, as after a process was stopped for a while."""
    parts = [regular(0.01, 3.0, offset) for offset in (0.0, 4.0, 4.0 + 3.0 + 0.6, 20.0)]
    joints, wrench = joint_messages(np.concatenate(parts)), wrench_messages(np.concatenate(parts[:2] + parts[3:]))
    expected = feed(pipeline(0.01), in_time(joints, wrench))
    assert len(segments(expected)) == 3
    for seed, longest in enumerate((2, 30, 300, 3000)):
        messages = interleaved([list(joints), list(wrench)], longest, np.random.default_rng(seed))
        assert_same(feed(pipeline(0.01), messages), expected, tolerance=1e-12)
    whole = pipeline(0.01)
    feed(whole, in_time(joints, wrench))
    assert all(len(stream._segments) == 1 for stream in whole._sampler._streams.values()), "what is past is forgotten"


def interleaved(topics: list[list[Message]], longest: int, random: np.random.Generator) -> Iterator[Message]:
    """Each topic in its order; of one after the other up to ``longest`` messages at once."""
    while any(topics):
        for topic in topics:
            count = random.integers(1, longest + 1)
            yield from topic[:count]
            del topic[:count]


def test_a_topic_is_waited_for_for_a_minute() -> None:
    """Besides the filter's lag, which is 13 s."""
    cutoff, stamps = 0.2, regular(0.05, 100.0)
    joints, wrench = joint_messages(stamps), wrench_messages(stamps)
    late = [(message.stamp + 59_000_000_000, message) for message in wrench]
    ahead = sorted([*((message.stamp, message) for message in joints), *late], key=lambda entry: entry[0])
    assert_same(
        feed(pipeline(0.05, cutoff=cutoff), (message for _, message in ahead)),
        feed(pipeline(0.05, cutoff=cutoff), in_time(joints, wrench)),
        tolerance=1e-9,
    )


def segments(samples: Samples) -> list[Samples]:
    """The samples divided where more than twice the usual step lies between two."""
    steps = np.diff(samples.stamps)
    ends = np.flatnonzero(steps > 2 * np.median(steps)) + 1
    return [samples.select(part) for part in np.split(np.arange(len(samples)), ends)]


@pytest.mark.parametrize("topic", ["joints", "wrench"])
def test_a_gap_starts_a_new_segment(topic: str) -> None:
    """Nothing is interpolated or filtered across: each side is what it would be alone."""
    gap = (START + 3_000_000_000, START + 3_700_000_000)
    stamps, dense = regular(0.01, 7.0), regular(0.002, 7.0, offset=0.0007)
    joints, wrench = joint_messages(stamps), wrench_messages(dense)
    broken = joints if topic == "joints" else wrench
    kept = [message for message in broken if not gap[0] < message.stamp < gap[1]]
    assert len(kept) < len(broken)
    other = wrench if topic == "joints" else joints
    both = segments(feed(pipeline(), in_time(kept, other)))
    assert len(both) == 2
    for part, alone in zip(both, (lambda t: t <= gap[0], lambda t: t >= gap[1]), strict=True):
        side = [message for message in kept if alone(message.stamp)]
        assert_same(part, feed(pipeline(), in_time(side, other)), tolerance=1e-12)
    half_a_kernel = 0.4e9
    assert both[0].stamps[-1] <= gap[0] - half_a_kernel
    assert both[1].stamps[0] >= gap[1] + half_a_kernel


@pytest.mark.parametrize("gain", [-2.5, {"elbow": -2.5}])
def test_effort_gains_make_newton_metres(gain: float | dict[str, float]) -> None:
    """One number for all joints, or one by name; negative reverses the sign. Nothing else changes."""
    messages = joint_messages(regular(0.01, 6.0))
    plain = feed(pipeline_of(JOINTS, settings=SignalSettings(period=0.01)), messages)
    scaled = feed(pipeline_of(JOINTS, settings=SignalSettings(period=0.01, effort_gain=gain)), messages)
    factors = np.full(3, gain) if isinstance(gain, float) else np.array([1.0, -2.5, 1.0])
    np.testing.assert_allclose(scaled.effort, plain.effort * factors, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(scaled.position, plain.position)


def test_topics_must_differ() -> None:
    for topic in ("/wrench", "joint_states", "odom"):
        with pytest.raises(InputError, match="topics must differ"):
            pipeline_of(JOINTS, sensors=[SENSOR, WrenchSensor(topic, "foot", "external")])
