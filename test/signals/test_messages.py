"""ROS messages are parsed by attribute into frozen values: anything shaped like them will do.

What is remembered of messages: enough to make the same samples again, and no more than was asked for.
"""

from __future__ import annotations

from array import array
from dataclasses import FrozenInstanceError
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.signals import messages as module
from geomid_ros.signals.messages import JOINT_STATES, ODOM, AcceptedMessages, Recent, parse
from geomid_ros.signals.pipeline import SignalPipeline

from .feeding import pipeline_of
from .sent import JointMessage, WrenchMessage


def header(seconds: int, nanoseconds: int, frame: str = "") -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def quantity(**numbers: float) -> SimpleNamespace:
    return SimpleNamespace(**numbers)


def joint_state(seconds: int = 7, nanoseconds: int = 1, **arrays: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=header(seconds, nanoseconds),
        name=["b", "a"],
        **{"position": [1.0, 2.0], "velocity": [3.0, 4.0], "effort": [5.0, 6.0], **arrays},
    )


def odometry() -> SimpleNamespace:
    orientation = quantity(x=0.5, y=-0.5, z=0.5, w=-0.5)
    pose = SimpleNamespace(position=quantity(x=1.0, y=2.0, z=3.0), orientation=orientation)
    return SimpleNamespace(header=header(7, 1), pose=SimpleNamespace(pose=pose))


def wrench(frame: str = "tool", nanoseconds: int = 1) -> SimpleNamespace:
    values = SimpleNamespace(force=quantity(x=1.0, y=2.0, z=3.0), torque=quantity(x=4.0, y=5.0, z=6.0))
    return SimpleNamespace(header=header(7, nanoseconds, frame), wrench=values)


MESSAGES = {JOINT_STATES: joint_state(), ODOM: odometry(), "/ft": wrench()}


def accepted(*parsed: Any) -> tuple[list[tuple[str, int, list[float]]], SignalPipeline]:
    """What a pipeline for joints a and b accepts, and the pipeline."""
    seen: list[AcceptedMessages] = []
    sensors = [WrenchSensor("/ft", "tool", "mounted")]
    pipeline = pipeline_of(["a", "b"], floating_base=True, sensors=sensors, on_accepted=seen.append)
    for message in parsed:
        pipeline.push(message)
    return [(each.topic, int(each.stamps[0]), each.values[0].tolist()) for each in seen], pipeline


ARRAYS = {"list": list, "tuple": tuple, "numpy": np.array, "array": lambda numbers: array("d", numbers)}


@pytest.mark.parametrize("kind", ARRAYS)
def test_a_joint_state_is_read_whatever_its_arrays_are(kind: str) -> None:
    """rosbags gives numpy arrays, rclpy arrays of its own kind."""
    arrays = {"position": [1.0, 2.0], "velocity": [3.0, 4.0], "effort": [5.0, 6.0]}
    parsed = parse(JOINT_STATES, joint_state(**{key: ARRAYS[kind](numbers) for key, numbers in arrays.items()}))
    assert (parsed.names, parsed.topic) == (("b", "a"), JOINT_STATES)
    for found, numbers in zip(parsed.arrays, arrays.values(), strict=True):
        np.testing.assert_array_equal(found, numbers)
    assert accepted(parsed)[0] == [(JOINT_STATES, 7_000_000_001, [2.0, 1.0, 4.0, 3.0, 6.0, 5.0])]


@pytest.mark.parametrize("topic", MESSAGES)
def test_a_parsed_message_does_not_change(topic: str) -> None:
    """Neither itself nor with the arrays that it was made of."""
    source = np.array([1.0, 2.0])
    parsed = parse(topic, joint_state(position=source) if topic == JOINT_STATES else MESSAGES[topic])
    source[0] = 9.0
    assert parsed.arrays[0][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        parsed.arrays[0][0] = 9.0
    with pytest.raises(FrozenInstanceError):
        parsed.stamp = 9  # type: ignore[misc]


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
