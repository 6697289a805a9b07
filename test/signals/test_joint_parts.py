"""Joint messages of several publishers are put together as if one had sent them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geomid_ros.model.samples import Samples
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings

from .feeding import JOINTS, Motion, assert_same, balanced, feed, in_time, joint_messages, pipeline_of, regular
from .sent import JointMessage

STAMPS = regular(0.01, 4.0)
WHOLE = joint_messages(STAMPS, velocity=True)


def merging(*, merge: bool = True) -> SignalPipeline:
    return pipeline_of(JOINTS, settings=SignalSettings(period=0.01, merge=merge))


def only(message: JointMessage, *names: str) -> JointMessage:
    """The part of a message that has some of the joints."""
    places = [message.names.index(name) for name in names]
    numbers = {key: np.asarray(getattr(message, key))[places] for key in ("position", "velocity", "effort")}
    return replace(message, names=names, **numbers)


@cache
def expected() -> Samples:
    return feed(merging(merge=False), WHOLE)


def test_parts_with_the_same_stamps_are_the_whole() -> None:
    """Right before left, left before right."""
    left = [only(message, "shoulder") for message in WHOLE]
    right = [only(message, "wrist", "elbow") for message in WHOLE]
    both = [part for index, pair in enumerate(zip(left, right, strict=True)) for part in pair[:: 1 - 2 * (index % 2)]]
    pipeline = merging()
    assert_same(feed(pipeline, both), expected(), tolerance=0.0)
    assert balanced(pipeline, both)
    assert pipeline.ledger.topics["joint_states"].accepted == 2 * len(WHOLE)


def test_parts_with_stamps_of_their_own_meet_on_the_line_between() -> None:
    """Two rates: the motion's curvature over a millisecond is all that is lost."""
    quick = [only(message, "shoulder") for message in joint_messages(regular(0.001, 4.0), velocity=True)]
    slow = [only(message, "elbow", "wrist") for message in joint_messages(regular(0.01, 4.0, 0.0003), velocity=True)]
    samples = feed(merging(), in_time(quick, slow))
    common = np.isin(expected().stamps, samples.stamps)
    assert np.count_nonzero(common) > 0.9 * len(samples)
    truth = expected().select(common)
    shared = samples.select(np.isin(samples.stamps, truth.stamps))
    assert np.max(np.abs(shared.position - truth.position)) < 1e-4
    assert np.max(np.abs(shared.effort - truth.effort)) < 1e-3 * np.max(np.abs(truth.effort))


@pytest.mark.parametrize("first", ["shoulder", "wrist"])
def test_a_slow_part_does_not_slow_down_the_others(first: str) -> None:
    """A gripper at 2 Hz that hardly moves: the arm is what it is without, the gripper's efforts are left out. Which of
    them begins does not matter."""
    slow_stamps = regular(0.5, 8.0, 0.0 if first == "wrist" else 0.003)
    motion = Motion(amplitudes=np.array([[1.0, 0.2], [0.8, 0.1], [0.0, 0.0]]))
    arm = [only(message, "shoulder", "elbow") for message in joint_messages(regular(0.01, 8.0), motion, velocity=True)]
    gripper = [only(message, "wrist") for message in joint_messages(slow_stamps, motion, velocity=True)]
    pipeline, messages = merging(), in_time(arm, gripper)
    samples = feed(pipeline, messages)
    truth = feed(merging(merge=False), joint_messages(regular(0.01, 8.0), motion, velocity=True))
    truth = truth.select(np.isin(truth.stamps, samples.stamps))
    assert np.ptp(samples.stamps) > 6.0e9
    assert len(truth) == len(samples), "at the arm's rate"
    for name in ("position", "velocity", "acceleration", "effort"):
        np.testing.assert_allclose(getattr(samples, name)[:, :2], getattr(truth, name)[:, :2], atol=1e-9)
    assert np.all(np.isnan(samples.effort[:, 2]))
    assert not np.any(samples.velocity[:, 2])
    assert balanced(pipeline, messages)
    assert pipeline.unmeasured == ("wrist",)
    assert pipeline.silent == ()
    notes = pipeline.ledger.topics["joint_states"].noted
    assert any("only 2.0 messages per second of 'wrist'" in note for note in notes)


def test_a_slow_part_that_falls_silent_is_missed() -> None:
    """Between the last message before and the first one after nothing is made up."""
    arm = [only(message, "shoulder", "elbow") for message in joint_messages(regular(0.01, 9.0), velocity=True)]
    stamps = regular(0.5, 9.0)
    heard = stamps[(stamps < stamps[6]) | (stamps > stamps[12])]
    gripper = [only(message, "wrist") for message in joint_messages(heard, velocity=True)]
    pipeline = merging()
    silent = []
    for message in in_time(arm, gripper):
        pipeline.push(message)
        silent.append(pipeline.silent)
    samples = pipeline.collect()
    assert ("wrist",) in silent
    assert silent[-1] == ()
    assert samples is not None
    assert not np.any((samples.stamps > stamps[5]) & (samples.stamps < stamps[13]))
    assert np.any(samples.stamps > stamps[13])


def test_others_messages_are_named() -> None:
    """A gripper's, and those of a publisher that has another's joint."""
    parts = [only(message, *names) for message in WHOLE for names in (("shoulder",), ("elbow", "wrist"))]
    strangers = [replace(only(WHOLE[50], "shoulder"), names=("finger",)), only(WHOLE[50], "shoulder", "elbow")]
    pipeline = merging()
    assert_same(feed(pipeline, [*parts[:100], *strangers, *parts[100:]]), expected(), tolerance=0.0)
    rejected = pipeline.ledger.topics["joint_states"].rejected
    assert rejected == {
        "none of the robot's joints": 1,
        "driver error: joint 'shoulder' comes with others than before": 1,
    }


def test_a_clock_set_back_begins_all_parts_anew() -> None:
    parts = [only(message, *names) for message in WHOLE for names in (("shoulder",), ("elbow", "wrist"))]
    pipeline = merging()
    samples = feed(pipeline, [*parts, *parts])
    assert balanced(pipeline, [*parts, *parts])
    first = expected()
    assert_same(samples.select(slice(len(first))), first, tolerance=0.0)
    assert len(samples) > 1.9 * len(first)
