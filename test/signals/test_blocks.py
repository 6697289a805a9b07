"""The same messages in blocks of any size, or one by one: the same samples, the same counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.model.samples import Samples
from geomid_ros.signals.messages import AcceptedMessages
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings

from . import spoiled as randomly
from .feeding import JOINTS, balanced, joint_messages, pipeline_of, regular
from .sent import Message
from .spoiled import in_parts


def in_blocks(target: SignalPipeline, messages: Sequence[Message], size: int) -> Samples:
    samples = in_parts(target, messages, range(size, len(messages), size))
    assert samples is not None
    return samples


def assert_same_to_the_last_digit(actual: Samples, expected: Samples) -> None:
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(actual.arrays[name], array, err_msg=name)


def test_a_pause_of_frozen_messages_is_a_pause() -> None:
    """Longer than the longest gap, within one block."""
    clean = joint_messages(regular(0.01, 4.0), velocity=True)
    messages = [replace(m, **{k: getattr(clean[200], k) for k in ("position", "velocity", "effort")})
                if 200 < index < 300 else m for index, m in enumerate(clean)]  # fmt: skip
    alone, together = (pipeline_of(JOINTS, settings=SignalSettings(period=0.01)) for _ in range(2))
    assert_same_to_the_last_digit(in_blocks(together, messages, 10_000), in_blocks(alone, messages, 1))
    assert together.ledger.topics == alone.ledger.topics
    assert sum(together.ledger.topics["joint_states"].rejected.values()) == 99


@pytest.mark.parametrize(("merge", "seed"), [(False, 1), (True, 1), (True, 2)])
def test_random_faults_in_random_blocks(merge: bool, seed: int) -> None:
    """One by one, in blocks of random sizes, and all at once: the same ledger, notes, accepted messages and samples,
    and all accounted for."""
    rng = np.random.default_rng(seed)
    messages = randomly.spoiled(rng, merge=merge)
    random = np.sort(rng.integers(0, len(messages), rng.integers(1, 60))).tolist()
    found = []
    for ends in (range(len(messages)), random, ()):
        seen: list[AcceptedMessages] = []
        target = randomly.pipeline(merge=merge, on_accepted=seen.append)
        samples = in_parts(target, messages, ends)
        assert target.waiting_count == 0
        assert balanced(target, messages)
        topics = target.ledger.topics
        taken = {t: b"".join(each.values.tobytes() for each in seen if each.topic == t) for t in topics}
        found.append((samples, topics, target.silent, target.unmeasured, taken))
    for samples, *others in found[1:]:
        assert others == list(found[0][1:])
        assert (samples is None) == (found[0][0] is None)
        if samples is not None and found[0][0] is not None:
            assert_same_to_the_last_digit(samples, found[0][0])
