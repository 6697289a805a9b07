"""Estimates are made in proportion to what is new."""

from __future__ import annotations

from geomid_ros.live.solver import Pace


def test_an_estimate_is_worth_making_while_much_is_new() -> None:
    pace = Pace()
    assert [pace.is_due(rows, much_is_new=True) for rows in (10, 20, 30)] == [True, True, True]


def test_and_at_every_tenth_period_though_little_is() -> None:
    pace = Pace()
    worth = [pace.is_due(rows, much_is_new=False) for rows in range(1, 31)]
    assert [number for number, now in enumerate(worth, start=1) if now] == [10, 20, 30]


def test_and_once_no_more_data_come() -> None:
    pace = Pace()
    assert [pace.is_due(rows, much_is_new=False) for rows in (10, 20, 20)] == [False, False, True]


def test_periods_are_counted_from_the_last_time_that_it_was_worth_making() -> None:
    pace = Pace()
    for rows in range(1, 6):
        pace.is_due(rows, much_is_new=False)
    pace.is_due(6, much_is_new=True)
    assert [pace.is_due(rows, much_is_new=False) for rows in range(7, 17)] == 9 * [False] + [True]
