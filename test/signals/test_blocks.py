"""The same messages in blocks of any size, or one by one: the same samples, the same counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.signals.messages import AcceptedMessages
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings

from . import spoiled as randomly
from .feeding import JOINTS, balanced, in_time, jittered, joint_messages, regular, without, wrench_messages
from .sent import JointMessage, Message
from .spoiled import in_parts

NAN = float("nan")


def changed(message: Any, key: str, place: int, value: float) -> Any:
    values = np.array(getattr(message, key), dtype=float)
    values[place] = value
    return replace(message, **{key: values})


FAULTS: tuple[Callable[[Any], Any], ...] = (
    lambda m: replace(m, stamp=0),
    lambda m: replace(m, stamp=-1),
    lambda m: replace(m, stamp=m.stamp - 15_000_000),
    lambda m: replace(m, stamp=m.stamp - 3_000_000_000),
    lambda m: replace(m, stamp=m.stamp + 3_000_000_000),
    lambda m: replace(m, frame="base") if not isinstance(m, JointMessage) else replace(m, effort=()),
    lambda m: changed(m, "effort", 2, NAN) if isinstance(m, JointMessage) else changed(m, "wrench", 0, NAN),
    lambda m: changed(m, "position", 1, NAN) if isinstance(m, JointMessage) else m,
    lambda m: replace(m, effort=[0.0] * 3) if isinstance(m, JointMessage) else m,
    lambda m: replace(m, velocity=()) if isinstance(m, JointMessage) else m,
    lambda m: replace(m, names=m.names[::-1]) if isinstance(m, JointMessage) else m,
    lambda m: without(m, "elbow") if isinstance(m, JointMessage) else m,
)


def spoiled(seed: int, share: float) -> list[Message]:
    """Messages of two topics with faults of all kinds, frozen ones and a clock that is set back."""
    rng = np.random.default_rng(seed)
    clean = in_time(joint_messages(jittered(0.01, 3.3, seed), velocity=True), wrench_messages(regular(0.004, 3.3)))
    result: list[Message] = []
    for index, message in enumerate([*clean, *clean[:900]] if seed % 2 else clean):
        result.append(message)
        if rng.random() < share:
            result.append(FAULTS[rng.integers(len(FAULTS))](message))
        if rng.random() < share and isinstance(message, JointMessage):
            result += [replace(message, stamp=message.stamp + 1000 * step) for step in range(1, 4)]
        if rng.random() < 0.1 * share:
            result += [FAULTS[0](message)] * int(rng.integers(30)) + clean[index + 200 : index + 203]
    return result


def pipeline(seen: list[AcceptedMessages] | None = None, **settings: Any) -> SignalPipeline:
    sensor = WrenchSensor("/wrench", "tool", "mounted", axes=("fx", "fz"))
    told = {} if seen is None else {"on_accepted": seen.append}
    return SignalPipeline(JOINTS, sensors=[sensor], settings=SignalSettings(**settings), continuous=["wrist"], **told)


def in_blocks(target: SignalPipeline, messages: Sequence[Message], size: int) -> Samples:
    samples = in_parts(target, messages, range(size, len(messages), size))
    assert samples is not None
    return samples


def assert_same_to_the_last_digit(actual: Samples, expected: Samples) -> None:
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(actual.arrays[name], array, err_msg=name)


@cache
def one_by_one(seed: int, share: float) -> tuple[list[Message], SignalPipeline, list[AcceptedMessages], Samples]:
    """Messages, the pipeline that took them, what it accepted, and its samples."""
    messages, seen = spoiled(seed, share), list[AcceptedMessages]()
    alone = pipeline(seen)
    return messages, alone, seen, in_blocks(alone, messages, 1)


@pytest.mark.parametrize("size", [17, 10_000])
@pytest.mark.parametrize("seed", [0, 1])
def test_blocks_of_any_size_make_the_same_samples(size: int, seed: int) -> None:
    messages, alone, told, expected = one_by_one(seed, 0.04)
    seen: tuple[list[AcceptedMessages], list[AcceptedMessages]] = (told, [])
    together = pipeline(seen[1])
    assert_same_to_the_last_digit(in_blocks(together, messages, size), expected)
    ledgers = alone.ledger.topics, together.ledger.topics
    for topic, account in ledgers[0].items():
        theirs = ledgers[1][topic]
        assert (account.accepted, account.rejected) == (theirs.accepted, theirs.rejected)
    assert alone.waiting_count == together.waiting_count
    assert balanced(together, messages)
    assert together.unmeasured == alone.unmeasured
    for topic in ledgers[0]:
        values = [np.concatenate([each.values for each in told if each.topic == topic]) for told in seen]
        np.testing.assert_array_equal(*values)


def test_parts_of_a_robot_are_joined_in_blocks_as_one_by_one() -> None:
    """Messages of two publishers, the second one a little later each time; both begin anew with an earlier clock."""
    first, second = (joint_messages(regular(0.01, 2.5, offset)) for offset in (0.0, 0.003))
    part, other = [without(m, "shoulder") for m in first], [without(without(m, "elbow"), "wrist") for m in second]
    messages = [message for pair in zip(part, other, strict=True) for message in pair]
    messages += messages[:300]
    alone, together = (SignalPipeline(JOINTS, settings=SignalSettings(period=0.01, merge=True)) for _ in range(2))
    assert_same_to_the_last_digit(in_blocks(together, messages, 50), in_blocks(alone, messages, 1))
    assert together.ledger.topics == alone.ledger.topics


def test_a_pause_of_frozen_messages_is_a_pause() -> None:
    """Longer than the longest gap, within one block."""
    clean = joint_messages(regular(0.01, 6.0), velocity=True)
    messages = [replace(m, **{k: getattr(clean[200], k) for k in ("position", "velocity", "effort")})
                if 200 < index < 300 else m for index, m in enumerate(clean)]  # fmt: skip
    alone, together = (SignalPipeline(JOINTS, settings=SignalSettings(period=0.01)) for _ in range(2))
    assert_same_to_the_last_digit(in_blocks(together, messages, 10_000), in_blocks(alone, messages, 1))
    assert together.ledger.topics == alone.ledger.topics
    assert sum(together.ledger.topics["joint_states"].rejected.values()) == 99


@pytest.mark.parametrize("merge", [False, True], ids=["one publisher", "two publishers"])
def test_random_faults_in_random_blocks(merge: bool) -> None:
    assert_blocks_do_not_matter(np.random.default_rng(1), merge=merge)


def assert_blocks_do_not_matter(rng: np.random.Generator, *, merge: bool) -> None:
    """One by one, in blocks of random sizes, and all at once: the same ledger, notes and samples, and all accounted
    for."""
    messages = randomly.spoiled(rng, merge=merge)
    random = np.sort(rng.integers(0, len(messages), rng.integers(1, 60))).tolist()
    found = []
    for ends in (range(len(messages)), random, ()):
        seen: list[AcceptedMessages] = []
        target = randomly.pipeline(merge=merge, on_accepted=seen.append)
        samples = in_parts(target, messages, ends)
        assert target.waiting_count == 0
        assert balanced(target, messages)
        found.append((samples, target.ledger.topics, target.silent, target.unmeasured))
    for samples, *others in found[1:]:
        assert others == list(found[0][1:])
        assert (samples is None) == (found[0][0] is None)
        if samples is not None and found[0][0] is not None:
            assert_same_to_the_last_digit(samples, found[0][0])
