"""Samples are cut at pauses, and nothing is lost."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.model.samples import Samples

PERIOD = 10_000_000  # [ns]


def samples(stamps: list[int]) -> Samples:
    nothing = np.zeros((len(stamps), 0))
    numbers = np.arange(float(len(stamps)))[:, None]
    motion = [numbers] * 4
    return Samples(PERIOD * np.array(stamps, dtype=np.int64), *motion, nothing, nothing, nothing, nothing[:, None])


@pytest.mark.parametrize(
    ("stamps", "lengths"),
    [
        ([0, 1, 2, 3, 5, 6, 7, 17, 18], [4, 3, 2]),
        ([0, 1, 2, 3], [4]),
        ([0, 1, 2, 5], [3, 1]),
        ([0, 9], [2]),
        ([4], [1]),
        ([], [0]),
    ],
)
def test_stretches_are_the_parts_between_pauses(stamps: list[int], lengths: list[int]) -> None:
    whole = samples(stamps)
    parts = whole.stretches()
    assert [len(part) for part in parts] == lengths
    np.testing.assert_array_equal(np.concatenate([part.stamps for part in parts]), whole.stamps)
    np.testing.assert_array_equal(np.concatenate([part.effort for part in parts]), whole.effort)


@pytest.mark.parametrize("count", [0, 1, 999, 1000, 1001, 2500])
def test_pieces_are_the_whole_a_thousand_at_a_time(count: int) -> None:
    whole = samples(list(range(count)))
    pieces = list(whole.in_pieces())
    assert all(0 < len(piece) <= 1000 for piece in pieces)
    assert [stamp for piece in pieces for stamp in piece.stamps] == whole.stamps.tolist()
    assert all(np.shares_memory(piece.effort, whole.effort) for piece in pieces), "no copies"
