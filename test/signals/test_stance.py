"""Which feet stand, by what their legs bear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from model.robots import fixed_base

from geomid_ros.model.samples import Samples
from geomid_ros.signals.moving_base import Stance
from geomid_ros.types import FloatArray, IntArray

STEP = 10_000_000  # [ns]
CUTOFF = 20.0  # [Hz], of whose period samples are five


def samples_at(stamps: IntArray, loads: FloatArray) -> Samples:
    """Samples of as many joints as feet, whose efforts are what the feet bear."""
    return fixed_base(stamps, *np.zeros((3, *loads.shape)), loads)


def judged(samples: Samples, sizes: Sequence[int]) -> Samples:
    """What comes of samples, so many of which come at once."""
    stance, found = Stance(lambda each: each.effort, CUTOFF), []
    for end, size in zip(np.cumsum(sizes), sizes, strict=True):
        known = stance.with_stance(samples.select(slice(int(end) - size, int(end))))
        found += [known] if known is not None else []
    return Samples.concatenate(found)


def stepping(count: int = 60) -> Samples:
    """One foot is in the air from the 20th sample to the 40th, one bears a little all of the time, one nothing."""
    loads = np.ones((count, 3)) * [1.0, 0.2, 0.01]
    loads[20:41, 0] = 0.05
    return samples_at(STEP * np.arange(1, count + 1), loads)


def test_a_foot_swings_while_it_bears_nothing_a_period_before_and_after() -> None:
    found = judged(stepping(), [60])
    assert len(found) == 55  # the last ones are held: nobody knows what follows
    assert np.flatnonzero(~found.standing[:, 0]).tolist() == list(range(25, 36))
    assert found.standing[:, 1].all()
    assert not found.standing[:, 2].any()


@pytest.mark.parametrize(("load", "stands"), [(0.09, False), (0.11, True)])
def test_a_foot_is_in_the_air_below_a_tenth_of_its_share(load: float, stands: bool) -> None:
    found = judged(samples_at(STEP * np.arange(1, 21), np.full((20, 1), load)), [20])
    assert np.all(found.standing == stands)


def test_what_is_not_known_stands() -> None:
    loads = np.full((20, 1), 0.01)
    loads[10] = np.nan
    found = judged(samples_at(STEP * np.arange(1, 21), loads), [20])
    assert np.flatnonzero(found.standing[:, 0]).tolist() == list(range(5, 15))


@pytest.mark.parametrize("sizes", [[1] * 60, [7, 3, 20, 30], [58, 2], [26, 1, 33]])
def test_it_does_not_matter_how_many_come_at_once(sizes: list[int]) -> None:
    together, found = judged(stepping(), [60]), judged(stepping(), sizes)
    np.testing.assert_array_equal(found.stamps, together.stamps)
    np.testing.assert_array_equal(found.standing, together.standing)
    np.testing.assert_array_equal(found.effort, together.effort)


def test_after_a_pause_or_a_clock_set_back_nothing_of_before_counts() -> None:
    stamps = STEP * np.array([*range(1, 31), *range(1001, 1021), *range(101, 131)])
    loads = np.where(np.arange(80) < 30, 1.0, 0.0)[:, None]
    for sizes in ([80], [30, 20, 30], [1] * 80):
        found = judged(samples_at(stamps, loads), sizes)
        assert len(found) == 30 + 15 + 25  # held when the clock is set back, and at the end
        np.testing.assert_array_equal(found.standing[:, 0], found.effort[:, 0] > 0.5)
