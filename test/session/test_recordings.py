"""What is fitted and what is held out: by time, whole bags or the end of each, whatever the batches."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geomid_ros.errors import InputError
from geomid_ros.model.samples import Samples
from geomid_ros.session.recordings import Bags, divided

PERIOD = 10_000_000  # [ns]
BAG, OTHER = Path("a"), Path("b")


def recording(count: int) -> Samples:
    """Samples of one joint on a grid, with a pause after the third."""
    stamps = 1_700_000_000_000_000_000 + PERIOD * np.arange(count)
    stamps[3:] += 5 * PERIOD
    joint = np.zeros((count, 1))
    return Samples(
        stamps=stamps,
        position=joint,
        velocity=joint,
        acceleration=joint,
        effort=joint,
        base_pose=np.zeros((count, 0)),
        base_velocity=np.zeros((count, 0)),
        base_acceleration=np.zeros((count, 0)),
        wrenches=np.zeros((count, 0, 6)),
    )


@settings(deadline=None, derandomize=True, database=None)
@given(count=st.integers(2, 40), share=st.floats(0.0, 1.0), cuts=st.lists(st.integers(1, 39)))
def test_the_end_is_held_out_whatever_the_batches(count: int, share: float, cuts: list[int]) -> None:
    whole = recording(count)
    edges = sorted({0, count, *(cut for cut in cuts if cut < count)})
    batches = [whole.select(slice(a, b)) for a, b in pairwise(edges)]
    parts = divided(batches, share)
    early = np.concatenate([first.stamps for first, _ in parts])
    late = np.concatenate([second.stamps for _, second in parts])
    np.testing.assert_array_equal(np.concatenate([early, late]), whole.stamps)
    duration = whole.stamps[-1] - whole.stamps[0]
    assert all(whole.stamps[-1] - stamp <= share * duration + 1 for stamp in late)
    assert all(whole.stamps[-1] - stamp >= share * duration - 1 for stamp in early)


def test_all_or_nothing() -> None:
    whole = recording(10)
    for share, expected in ((0.0, (10, 0)), (1.0, (0, 10))):
        ((early, late),) = divided([whole], share)
        assert (len(early), len(late)) == expected


@pytest.mark.parametrize(
    ("bags", "shares"),
    [
        (Bags(fitted=[BAG, OTHER]), [(BAG, 0.3), (OTHER, 0.3)]),
        (Bags(fitted=[BAG], hold_out=0.5), [(BAG, 0.5)]),
        (Bags(fitted=[BAG], validate=[OTHER]), [(BAG, 0.0), (OTHER, 1.0)]),
        (Bags(fitted=[BAG], validate=[OTHER], hold_out=0.2), [(BAG, 0.2), (OTHER, 1.0)]),
    ],
)
def test_which_share_of_which_bag(bags: Bags, shares: list[tuple[Path, float]]) -> None:
    assert bags.shares == shares


@pytest.mark.parametrize("share", [-0.1, 0.91, float("nan")])
def test_a_share_out_of_range_is_refused(share: float) -> None:
    with pytest.raises(InputError, match=r"expected a number from 0 to 0\.9"):
        Bags(fitted=[BAG], hold_out=share)
