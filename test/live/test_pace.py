"""Estimates are made in proportion to what is new."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import pytest

from geomid_ros.live.solver import Pace


@pytest.mark.parametrize(
    ("rows", "much_is_new", "due"),
    [
        ([10, 20, 30], [True], [1, 2, 3]),
        (range(1, 31), [False], [10, 20, 30]),
        ([10, 20, 20], [False], [3]),
        (range(1, 17), [number == 6 for number in range(1, 17)], [6, 16]),
    ],
    ids=["much is new", "at every tenth period", "no more data come", "a tenth is counted from the last one"],
)
def test_an_estimate_is_due(rows: Sequence[int], much_is_new: list[bool], due: list[int]) -> None:
    pace = Pace()
    found = [pace.is_due(count, is_new) for count, is_new in zip(rows, cycle(much_is_new), strict=False)]
    assert [number for number, is_due in enumerate(found, start=1) if is_due] == due
