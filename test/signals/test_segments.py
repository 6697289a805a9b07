"""Segments of numbers on the time grid: which instants are ready, and what is kept.

A whole recording through the low-pass.
"""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.kernels import GridValues, filtered
from geomid_ros.signals.streams import Grid, PoseSegment, Stream, VectorSegment
from geomid_ros.types import FloatArray

PERIOD = 10_000_000  # [ns]
CUTOFF = 10.0
GRID = Grid(PERIOD, CUTOFF)
START = 1000 * PERIOD
UNIT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def stamps(count: int, step: int = PERIOD, offset: int = 0) -> list[int]:
    return [START + offset + index * step for index in range(count)]


def push(target: VectorSegment | Stream[VectorSegment], stamp: int, values: FloatArray) -> None:
    target.push(np.array([stamp]), values[None])


def filled(segment: VectorSegment, times: list[int], values: FloatArray | None = None) -> VectorSegment:
    for index, stamp in enumerate(times):
        push(segment, stamp, np.array([float(stamp - START)]) if values is None else values[index])
    return segment


def poses(times: list[int]) -> PoseSegment:
    segment = PoseSegment(GRID)
    for stamp in times:
        push(segment, stamp, UNIT)
    return segment


def test_the_grid() -> None:
    """Kernels as long as four periods of the cutoff; eight samples in one period."""
    taps = GRID.kernels.shape[1]
    assert (GRID.half, taps) == (23, 47), "two periods of ten instants, and three for the derivative"
    sharp = GRID.sharp_kernels.shape[1] // 2
    assert GRID.lag == GRID.half + sharp
    assert sharp == round(2.0 / (0.01 * 40.0)) + 3, "four times the cutoff"
    assert Grid(PERIOD, 30.0).sharp_kernels.shape[1] // 2 == sharp, "but no more than 0.4 of the rate"
    assert [Grid(PERIOD, cutoff).stride for cutoff in (0.5, 1.0, 10.0, 20.0)] == [25, 12, 1, 1]


@pytest.mark.parametrize("offset", [0, 1, 3_000_000, PERIOD - 1])
def test_a_pose_is_ready_where_the_window_is_between_the_second_and_the_last_but_one(offset: int) -> None:
    """A cubic needs a message before and one after each of the two that it is between."""
    times = stamps(80, offset=offset)
    ready = poses(times).ready()
    for instant in (ready.start, ready.stop - 1):
        window = [(instant + lag) * PERIOD for lag in (-GRID.half, GRID.half)]
        assert times[1] <= window[0]
        assert window[1] <= times[-2]
    assert times[1] > (ready.start - 1 - GRID.half) * PERIOD
    assert times[-2] < (ready.stop + GRID.half) * PERIOD
    values = poses(times).filtered(ready)
    np.testing.assert_allclose(values[0], np.tile(UNIT, (len(ready), 1)), atol=1e-12)
    np.testing.assert_allclose(values[1:], 0.0, atol=1e-9)


@pytest.mark.parametrize("offset", [0, 1, 4_000_000])
def test_vectors_are_ready_where_their_window_is_on_the_grid(offset: int) -> None:
    times = stamps(80, offset=offset)
    segment = filled(VectorSegment(GRID), times)
    ready = segment.ready()
    assert ready.start == -(-times[1] // PERIOD) + GRID.half
    assert ready.stop == times[-2] // PERIOD + 1 - GRID.half
    value, first, second = segment.filtered(ready)
    np.testing.assert_allclose(value[:, 0], [instant * PERIOD - START for instant in ready], rtol=1e-9)
    np.testing.assert_allclose(first[:, 0], 1e9, rtol=1e-9)
    np.testing.assert_allclose(second[:, 0], 0.0, atol=1e-3 * 1e9)


def test_what_is_appended_is_there_until_it_is_dropped() -> None:
    values, rng, expected = GridValues(), np.random.default_rng(1), np.zeros((0, 2))
    values.extend(0, np.zeros((0, 2)))
    assert (values.end, len(values.values)) == (0, 0)
    first = end = 100
    for _ in range(50):
        new = rng.normal(size=(int(rng.integers(1, 6)), 2))
        values.extend(end, new)
        drop = int(rng.integers(-1, len(expected) + 1))  # before the first: nothing
        values.drop_before(first + drop)
        expected, end = np.concatenate([expected, new])[max(drop, 0) :], end + len(new)
        first += max(drop, 0)
        np.testing.assert_array_equal(values.values, expected)
        assert (values.first, values.end) == (first, end)


def test_what_is_there_is_seldom_copied() -> None:
    """Though one is appended and one dropped each time."""
    values, copies = GridValues(), 0
    for end in range(1000):
        before = values.values
        values.extend(end, np.zeros((1, 2)))
        values.drop_before(end - 100)
        copies += not np.shares_memory(before, values.values)
    assert copies < 100


def test_rows_that_are_asked_for_are_those_of_the_whole() -> None:
    """At the ends, too, beyond which the outermost values go on."""
    values = np.random.default_rng(0).normal(size=(200, 3))
    at = np.array([0, 1, 50, 51, 199])
    for some, whole in zip(filtered(values, 8.0, 0.01, at), filtered(values, 8.0, 0.01), strict=True):
        np.testing.assert_allclose(some, whole[at], rtol=1e-12, atol=1e-12 * np.max(np.abs(whole)))
