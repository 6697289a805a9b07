"""What is fitted and what is held out: by time, whole bags or the end of each, whatever the batches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model.robots import fixed_base

from geomid_ros.errors import InputError
from geomid_ros.model.samples import SAMPLES_PER_PIECE, Samples
from geomid_ros.session import recordings
from geomid_ros.session.recordings import Bags, check_measured, split_held_out

PERIOD = 10_000_000  # [ns]
BAG, OTHER = Path("a"), Path("b")


def recording(count: int) -> Samples:
    """Samples of one joint on a grid, with a pause after the third."""
    stamps = 1_700_000_000_000_000_000 + PERIOD * np.arange(count)
    stamps[3:] += 5 * PERIOD
    return fixed_base(stamps, *np.zeros((4, count, 1)))


@settings(deadline=None, derandomize=True, database=None)
@given(count=st.integers(2, 40), share=st.floats(0.0, 1.0))
def test_the_end_is_held_out(count: int, share: float) -> None:
    whole = recording(count)
    early, late = (part.stamps for part in split_held_out(whole, share))
    np.testing.assert_array_equal(np.concatenate([early, late]), whole.stamps)
    duration = whole.stamps[-1] - whole.stamps[0]
    assert all(whole.stamps[-1] - stamp <= share * duration + 1 for stamp in late)
    assert all(whole.stamps[-1] - stamp >= share * duration - 1 for stamp in early)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, (19 * PERIOD + 1) / (44 * PERIOD + 1)])  # the last at an instant
@pytest.mark.parametrize("size", [1, 4, 7, 40])
def test_what_is_surely_fitted_is_passed_on_while_the_bag_is_read(
    share: float, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And in the end it is what a division of the whole says."""
    whole = recording(40)
    batches = [whole.select(slice(begin, begin + size)) for begin in range(0, 40, size)]
    fitted: list[int] = []
    kept_most = 0

    def read(*_: object) -> Iterator[Samples]:
        nonlocal kept_most
        for done, batch in enumerate(batches):
            kept_most = max(kept_most, done * size - len(fitted))
            yield batch

    monkeypatch.setattr(recordings, "Bag", MagicMock())
    monkeypatch.setattr(recordings, "read_samples", read)
    session = MagicMock(findings=(), configuration={"still_distance": 0.1}, **{"model.legs": None})
    session.robot.floating_base = True
    session.model.rows.return_value.targets = np.zeros(1)
    held_out = recordings.read_bags(session, Bags(fitted=[BAG], hold_out=share), lambda s: fitted.extend(s.stamps))
    early, late = split_held_out(whole, share)
    assert fitted == early.stamps.tolist()
    assert [stamp for batch in held_out for stamp in batch.stamps] == late.stamps.tolist()
    assert kept_most <= share * 45 + size, "no more is remembered than may be held out, and what came last"


@pytest.mark.parametrize("order", [[(20, 40), (0, 20)], [(20, 30), (0, 20), (30, 40)], [(30, 40), (0, 30)]])
def test_where_the_clock_was_set_back_the_stamps_decide(order: list[tuple[int, int]]) -> None:
    whole = recording(40)
    back = Samples.concatenate([whole.select(slice(begin, end)) for begin, end in order])
    early, late = split_held_out(back, 0.5)
    end = back.stamps[-1] + 1
    boundary = end - round(0.5 * (end - back.stamps[0]))
    assert early.stamps.tolist() == [stamp for stamp in back.stamps if stamp < boundary]
    assert late.stamps.tolist() == [stamp for stamp in back.stamps if stamp >= boundary]


def test_what_is_measured_late_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """And where it is measured soon the rest is not looked at."""
    seen: list[int] = []

    def rows(samples: Samples) -> Any:
        seen.append(len(samples))
        return MagicMock(targets=np.where(samples.stamps >= since, 1.0, np.nan))

    session = MagicMock(**{"model.legs": None})
    monkeypatch.setattr(session.model, "rows", rows)
    whole = recording(2500)
    for place in (2400, 0):
        since = whole.stamps[place]
        seen.clear()
        check_measured(session, [whole], [BAG])
        assert len(seen) == place // SAMPLES_PER_PIECE + 1
    since = whole.stamps[0]
    later = replace(whole, stamps=whole.stamps - 10**12)
    check_measured(session, [whole, later], [BAG])
    since = whole.stamps[-1] + 1
    with pytest.raises(InputError, match="no effort is measured"):
        check_measured(session, [whole], [BAG])


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
    assert bags.held_out_fractions == shares
