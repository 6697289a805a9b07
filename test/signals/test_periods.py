"""Messages in bursts are timed by their number in the row."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.clocks import RegularClock, in_bursts
from geomid_ros.signals.sampler import NOW_IN_BURSTS, UNEVEN
from geomid_ros.types import IntArray

from .feeding import START, balanced, joint_messages, regular
from .spoiled import in_parts, pipeline

MS = 1_000_000  # [ns]
PERIOD = 10 * MS


def received(sizes: IntArray, late: IntArray) -> tuple[IntArray, IntArray]:
    """When messages were measured and, in bursts of these sizes that are late by so much [ns], received."""
    measured = START + PERIOD * np.arange(int(np.sum(sizes)))
    ends = np.cumsum(sizes) - 1
    burst = np.repeat(np.arange(len(sizes)), sizes)
    within = np.arange(len(measured)) - (ends - sizes + 1)[burst]
    return measured, measured[ends][burst] + late[burst] + 10_000 * within


@pytest.mark.parametrize("size", [2, 5, 20])
def test_times_are_those_of_the_measurement(size: int) -> None:
    """To a constant, within the unevenness of the bursts' ends; with another size of bursts, and after a pause."""
    rng = np.random.default_rng(size)
    sizes = np.clip(rng.integers(size - 1, size + 2, 1000 // size), 1, None)
    measured, stamps = received(sizes, rng.integers(0, 2 * MS, len(sizes)))
    assert in_bursts(stamps[:100], 500 * MS)
    clock = RegularClock(stamps[:320])
    assert clock.is_right
    assert clock.period == pytest.approx(PERIOD, rel=3e-3)
    error = clock.times(stamps) - measured
    assert np.max(np.abs(error - np.mean(error))) < 3 * MS
    later = clock.times(stamps + (stamps[-1] - stamps[0]) + 5_000 * MS)
    assert later[0] - stamps[-1] == pytest.approx(5_000 * MS, abs=3 * size * PERIOD)
    assert np.all(np.diff(np.concatenate([later])) > 0)


@pytest.mark.parametrize("lost", [3, 6, 9])
def test_lost_messages_delay_those_after_them_at_once(lost: int) -> None:
    """By as many periods, from the next burst but one on."""
    measured, stamps = received(np.full(60, 10), np.zeros(60, dtype=np.int64))
    clock = RegularClock(stamps[:320])
    kept = np.r_[0:400, 400 + lost : len(stamps)]
    error = (clock.times(stamps[kept]) - measured[kept]) / PERIOD
    assert np.max(np.abs(error[420:] - np.mean(error[:400]))) < 0.5


def test_uneven_bursts_are_refused() -> None:
    """Nothing says when their messages were measured: they are refused, and counted, whatever the blocks."""
    rng = np.random.default_rng(3)
    stamps = START + np.cumsum(np.where(rng.random(1000) < 0.15, rng.integers(5 * MS, 450 * MS, 1000), 1000))
    messages = joint_messages(stamps)
    accounts = []
    for ends in ((), range(7, len(messages), 7)):
        target = pipeline(merge=False)
        assert in_parts(target, messages, ends) is None
        accounts.append(target.ledger.topics["joint_states"])
        assert balanced(target, messages)
    assert accounts[0] == accounts[1]
    assert accounts[0].rejected[UNEVEN] >= 640


def test_bursts_that_begin_later_are_named() -> None:
    stamps = regular(0.01, 12.0)
    places = np.arange(len(stamps))
    in_tens = np.where(places < 500, stamps, stamps[np.minimum(places // 10 * 10 + 9, len(stamps) - 1)] + places % 10)
    paused = stamps + np.where(places < 400, 0, 60_000 * MS)
    for expected, sent in ((0, stamps), (0, paused), (1, in_tens)):
        target = pipeline(merge=False)
        in_parts(target, joint_messages(sent), ())
        assert (target.ledger.topics["joint_states"].noted[NOW_IN_BURSTS] > 0) == bool(expected)
