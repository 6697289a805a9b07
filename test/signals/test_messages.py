"""What is remembered of messages: enough to make the same samples again, and no more than was asked for."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.signals import messages as module
from geomid_ros.signals.messages import JOINT_STATES, Recent
from geomid_ros.signals.pipeline import SignalPipeline

from .feeding import pipeline_of
from .sent import JointMessage, WrenchMessage

SENSOR = WrenchSensor("/wrench", "tool", "mounted", offset=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
NAMES = ("elbow", "shoulder")
PERIOD = 10_000_000  # [ns]
START = 1_700_000_000_000_000_000


def pipeline(recent: Recent | None = None) -> SignalPipeline:
    told = {"on_accepted": recent} if recent else {}
    return pipeline_of(("shoulder", "elbow"), sensors=[SENSOR], continuous=["elbow"], **told)


def feed(target: SignalPipeline, begin: int, end: int, start: int = START) -> None:
    rng = np.random.default_rng(begin)
    for index in range(begin, end):
        stamp, time = start + PERIOD * index, 0.01 * index
        position = [np.remainder(3.0 * time, 2.0 * np.pi), np.sin(time)]
        target.push(JointMessage(stamp, NAMES, position, [3.0, np.cos(time)], rng.standard_normal(2)))
        target.push(JointMessage(stamp, NAMES, position, [], []))  # the stamp is not later
        target.push(WrenchMessage("/wrench", stamp + 1_000_000, "tool", rng.standard_normal(6)))
        target.push(WrenchMessage("/wrench", stamp + 2_000_000, "hand", rng.standard_normal(6)))


def test_the_same_samples_can_be_made_again() -> None:
    recent = Recent(60.0)
    first, again = pipeline(recent), pipeline()
    feed(first, 0, 330)
    for entry in recent.entries():
        again.push_accepted(entry)
    ours, theirs = again.collect(), first.collect()
    assert ours is not None
    assert theirs is not None
    assert len(ours) > 100
    for name, own in theirs.arrays.items():
        np.testing.assert_array_equal(ours.arrays[name], own)
    for topic, ledger in again.ledger.topics.items():
        assert (ledger.received, ledger.rejected.total()) == (first.ledger.topics[topic].accepted, 0)


def test_only_the_last_seconds_are_kept() -> None:
    recent = Recent(1.0)
    feed(pipeline(recent), 0, 150)
    stamps = np.concatenate([entry.stamps for entry in recent.entries() if entry.topic == JOINT_STATES])
    np.testing.assert_array_equal(stamps, START + PERIOD * np.arange(50, 150))


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_WAITING_BYTES", 10_000)
    recent = Recent(60.0)
    feed(pipeline(recent), 0, 200)
    assert 0 < sum(entry.values.nbytes for entry in recent.entries()) < 10_000
    assert recent.entries()[-1].stamps[-1] == START + PERIOD * 199 + 1_000_000


def test_a_clock_that_is_set_back_starts_afresh() -> None:
    recent = Recent(60.0)
    target = pipeline(recent)
    feed(target, 0, 100)
    earlier = START - 100 * PERIOD * 1000
    feed(target, 0, 100, earlier)
    assert {bool(entry.stamps[0] < START) for entry in recent.entries()} == {True}
    assert len(recent.entries()) > 150
