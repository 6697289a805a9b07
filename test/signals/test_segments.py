"""Segments of numbers on the time grid: which instants are ready, and what is kept."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.columns import NO_COLUMNS, Entries
from geomid_ros.signals.grid_values import GridValues
from geomid_ros.signals.streams import Grid, JointSegment, PoseSegment, Segment, Stream, VectorSegment
from geomid_ros.types import FloatArray

PERIOD = 10_000_000  # [ns]
CUTOFF = 10.0
GRID = Grid(PERIOD, CUTOFF, 8.0)
START = 1000 * PERIOD
UNIT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def stamps(count: int, step: int = PERIOD, offset: int = 0) -> list[int]:
    return [START + offset + index * step for index in range(count)]


def push(target: Segment | Stream[VectorSegment], stamp: int, values: FloatArray) -> None:
    target.push(np.array([stamp]), values[None])


def filled(segment: Segment, times: list[int], values: FloatArray | None = None) -> Segment:
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
    assert Grid(PERIOD, 30.0, 8.0).sharp_kernels.shape[1] // 2 == sharp, "but no more than 0.4 of the rate"
    assert [Grid(PERIOD, cutoff, 8.0).stride for cutoff in (0.5, 1.0, 10.0, 20.0)] == [25, 12, 1, 1]


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


def test_three_poses_make_none() -> None:
    assert len(poses(stamps(3)).ready()) == 0


def test_poses_between_few_messages_are_interpolated_by_the_cubic_around_them() -> None:
    """A motion of third order is met whichever four messages are the nearest; also at both ends of the window."""
    times = stamps(60, step=25_000_000)
    segment = PoseSegment(GRID)
    for stamp in times:
        time = (stamp - START) * 1e-9
        push(segment, stamp, np.concatenate([[time**3, 0.5 * time**2, time], UNIT[3:]]))
    ready = segment.ready()
    pose, velocity, acceleration = segment.filtered(ready)
    time = np.array([instant * PERIOD - START for instant in ready]) * 1e-9
    # The low-pass keeps polynomials up to its second moment.
    second = np.sum(GRID.kernels[0] * np.arange(-GRID.half, GRID.half + 1) ** 2) * 1e-4
    np.testing.assert_allclose(pose[:, 0], time**3 + 3.0 * second * time, atol=1e-9)
    np.testing.assert_allclose(pose[:, 1], 0.5 * time**2 + 0.5 * second, atol=1e-9)
    rates = np.column_stack([3.0 * time**2 + 3.0 * second, time, 1.0 + 0.0 * time])
    np.testing.assert_allclose(velocity[:, :3], rates, atol=1e-7)
    np.testing.assert_allclose(acceleration[:, :2], np.column_stack([6.0 * time, 1.0 + 0.0 * time]), atol=1e-5)


def test_of_poses_those_are_kept_that_are_still_needed() -> None:
    times = stamps(200)
    segment, whole = poses(times), poses(times)
    instant = whole.ready()[100]
    segment.drop_before(instant)
    assert segment.ready() == range(instant, whole.ready().stop)
    np.testing.assert_array_equal(segment.filtered(range(instant, instant + 3))[0], np.tile(UNIT, (3, 1)))
    kept = len(segment._stamps)
    assert kept < 110
    segment.drop_before(instant - 50)
    assert len(segment._stamps) == kept


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


def test_fast_messages_between_two_instants_are_waited_for() -> None:
    """Ten in a period: most of them reach no new instant."""
    segment = filled(VectorSegment(GRID), stamps(1000, step=PERIOD // 10))
    assert len(segment.ready()) == 100 - 2 * GRID.half - 1


def test_vectors_before_an_instant_are_forgotten_but_for_its_window() -> None:
    segment, whole = (filled(VectorSegment(GRID), stamps(200)) for _ in range(2))
    instant = whole.ready()[50]
    segment.drop_before(instant)
    assert segment.ready() == range(instant, whole.ready().stop)
    np.testing.assert_array_equal(segment.filtered(segment.ready()), whole.filtered(segment.ready()))


def test_joints_wait_for_the_columns_of_effects() -> None:
    joints = JointSegment(GRID, Entries(NO_COLUMNS, 1))
    plain = VectorSegment(GRID)
    for stamp in stamps(200):
        push(joints, stamp, np.array([1.0, 0.0, 0.0]))
        push(plain, stamp, np.array([1.0, 0.0, 0.0]))
    sharp = GRID.lag - GRID.half
    assert joints.ready() == range(plain.ready().start + sharp, plain.ready().stop - sharp)
    assert joints.effects(joints.ready()).shape == (len(joints.ready()), 0)


class TestStream:
    GAP = 5 * PERIOD

    def stream(self, times: list[int]) -> Stream[VectorSegment]:
        stream = Stream(self.GAP, lambda: VectorSegment(GRID))
        for stamp in times:
            push(stream, stamp, np.zeros(1))
        return stream

    @pytest.mark.parametrize(("pause", "parts"), [(GAP, 1), (GAP + 1, 2)])
    def test_a_pause_longer_than_a_gap_begins_a_segment(self, pause: int, parts: int) -> None:
        first = stamps(80)
        stream = self.stream([*first, *(first[-1] + pause + index * PERIOD for index in range(80))])
        assert len(stream._segments) == parts

    def test_a_segment_is_left_when_its_end_is_passed(self) -> None:
        first = stamps(80)
        stream = self.stream([*first, *(first[-1] + 10 * PERIOD + index * PERIOD for index in range(80))])
        end = stream.segment.ready().stop
        assert not stream.skip_to(end - 1)
        before = stream.segment
        assert stream.skip_to(end)
        assert stream.segment is not before
        assert not stream.skip_to(10 * end), "the last one stays"

    def test_forgetting_leaves_segments_that_are_over(self) -> None:
        first = stamps(80)
        stream = self.stream([*first, *(first[-1] + 10 * PERIOD + index * PERIOD for index in range(200))])
        second = stream._segments[1].ready()
        stream.drop_before(second[5])
        assert len(stream._segments) == 1
        assert stream.segment.ready() == range(second[5], second.stop)


class TestGridValues:
    def test_what_is_appended_is_there_until_it_is_dropped(self) -> None:
        values, rng, expected, first = GridValues(), np.random.default_rng(1), np.zeros((0, 2)), 100
        assert (values.end, len(values.values)) == (0, 0)
        end = first
        for _ in range(200):
            new = rng.normal(size=(int(rng.integers(1, 6)), 2))
            values.extend(end, new)
            expected, end = np.concatenate([expected, new]), end + len(new)
            drop = int(rng.integers(0, 7))
            values.drop_before(first + drop)
            kept = min(drop, len(expected))
            expected, first = expected[drop:], first + drop
            if len(expected) == 0:
                first = end = values.end
            assert kept <= drop
            np.testing.assert_array_equal(values.values, expected)
            assert (values.first, values.end) == (first, end)
            assert len(values._room) <= 8 * (len(values.values) + 10)

    def test_dropping_before_the_first_does_nothing(self) -> None:
        values = GridValues()
        values.extend(10, np.ones((4, 1)))
        values.drop_before(9)
        assert (values.first, values.end, values.inside(1)) == (10, 14, range(11, 13))

    def test_values_are_correlated_with_kernels_around_each_instant(self) -> None:
        values, numbers = GridValues(), np.random.default_rng(2).normal(size=(30, 3))
        values.extend(50, numbers)
        kernels = np.random.default_rng(3).normal(size=(2, 5))
        instants = range(55, 70, 3)
        found = values.correlated(instants, kernels, 2)
        for place, instant in enumerate(instants):
            window = numbers[instant - 50 - 2 : instant - 50 + 3, :2]
            np.testing.assert_allclose(found[:, place], kernels @ window)
        assert values.correlated(instants, kernels).shape == (2, 5, 3)
