"""The few instants that are kept: bounded, apart, spread over all, and the same whatever the batches."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from estimation.arms import motion, samples

from geomid_ros.checks.recording_check import CheckResult, CheckTask, Excerpt, RecordingCheck
from geomid_ros.checks.sample_reservoir import STEP, RecentMotion, SampleReservoir
from geomid_ros.model.samples import Samples

RATE = 100.0
APART = 100_000_000


def recording(seconds: float) -> Samples:
    moving = motion(np.random.default_rng(0), 2, seconds, RATE)
    return samples(moving, moving.position, RATE)


def kept(recorded: Samples, batch: int) -> Samples:
    """What is kept of a recording that comes in batches."""
    instants = SampleReservoir()
    for begin in range(0, len(recorded), batch):
        instants.add(recorded.select(slice(begin, begin + batch)))
    assert instants.kept is not None
    return instants.kept.samples


@pytest.mark.parametrize("seconds", [3.0, 26.0, 200.0])
def test_they_are_bounded_apart_and_spread_over_all(seconds: float) -> None:
    recorded = recording(seconds)
    found = kept(recorded, 17)
    steps = np.diff(found.stamps)
    assert len(found) <= 250
    assert len(found) >= min(10.0 * seconds, 120)
    assert np.min(steps) >= APART
    assert np.max(steps) <= 1.1 * np.min(steps)
    assert recorded.stamps[-1] - found.stamps[-1] <= np.max(steps)


@pytest.mark.parametrize("at_once", [False, True])
def test_another_recording_with_earlier_stamps_is_taken_too(at_once: bool) -> None:
    instants, recorded = SampleReservoir(), recording(3.0)
    alone = len(kept(recorded, 17))
    for batch in [Samples.concatenate([recorded, recorded])] if at_once else [recorded, recorded]:
        instants.add(batch)
    assert len(instants) == 2 * alone
    assert instants.kept is not None
    assert np.bincount(instants.kept.recordings).tolist() == [alone, alone]


def test_a_stretch_has_the_last_instants_in_motion() -> None:
    recorded = recording(30.0)
    still = Samples(**{**recorded.arrays, "velocity": np.zeros_like(recorded.velocity)})
    later = Samples(**{**recorded.arrays, "stamps": recorded.stamps + 10**12})
    stretch = RecentMotion()
    for part in (recorded, still, later):
        for begin in range(0, len(part), 50):
            stretch.add(part.select(slice(begin, begin + 50)))
    found = stretch.samples
    assert found is not None
    assert 750 <= len(found) < 800
    assert np.all(np.diff(found.stamps // STEP) > 0)
    assert later.stamps[-1] - found.stamps[-1] < STEP


def test_nothing_is_compared_across_a_clock_that_was_set_back() -> None:
    """In the middle of what comes at once, as from a bag: of the motion the samples after that are kept."""
    seen: list[Excerpt] = []

    def judge(_: CheckTask, excerpt: Excerpt) -> CheckResult:
        seen.append(excerpt)
        return CheckResult()

    model: Any = SimpleNamespace(legs=None)
    recorded, check = recording(4.0), RecordingCheck(CheckTask(model, np.ones(2), {}), judge)
    check.add(Samples.concatenate([recorded, recorded]))
    check.findings()
    found = seen[0].recent_motion
    assert found is not None
    assert np.all(np.diff(found.stamps // STEP) > 0)
