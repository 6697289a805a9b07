"""Rows that are taken back leave no trace: the identifier knows what it would, had they never come."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from geomid_ros.estimation.identifier import NOT_MEASURED, BufferSettings, Identifier
from geomid_ros.model.samples import Samples

from .arms import Case, arm
from .test_identifier import content

BAD = (1,)  # a channel
BEGIN, END = 130, 260
COUNT = 400


@cache
def case() -> Case:
    """Four seconds of the small arm, in which one effort is not measured now and then."""
    found = arm("arm3", 0, seconds=4)
    effort = found.samples.effort.copy()
    effort[::7, 1] = np.nan
    return found.with_efforts(effort)


def begun(of: Case, forgetting_time: float, hold: int) -> Identifier:
    identifier = Identifier(of.model, buffer=BufferSettings(folds=4, block=20, forgetting_time=forgetting_time))
    identifier.buffer_last(hold)
    return identifier


def add(identifier: Identifier, samples: Samples, after: Callable[[int], None] = lambda _: None) -> Identifier:
    """Add them in pieces, and say how many there are after each."""
    for begin in range(0, len(samples), 39):
        identifier.add(samples.select(slice(begin, begin + 39)))
        after(min(begin + 39, len(samples)))
    return identifier


def without(of: Case, begin: int, end: int = COUNT) -> Case:
    """As if the channel had said nothing there."""
    effort = of.samples.effort.copy()
    effort[begin:end, BAD[0]] = np.nan
    return of.with_efforts(effort)


def assert_same(found: Identifier, expected: Identifier) -> None:
    """In all that is remembered, and in the estimate."""
    assert found.rows == expected.rows
    assert found.counts.made == expected.counts.made == found.rows + found.counts.rejected.total()
    np.testing.assert_allclose(content(found.snapshot()), content(expected.snapshot()), rtol=1e-10)
    ours, theirs = found.memory().summary, expected.memory().summary
    assert (ours.instants, ours.rows) == (theirs.instants, theirs.rows)
    np.testing.assert_allclose([ours.time, ours.weight], [theirs.time, theirs.weight], rtol=1e-12)
    np.testing.assert_allclose(ours.counts, theirs.counts, rtol=1e-12)
    np.testing.assert_allclose(found.solve().parameters, expected.solve().parameters, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("forgetting_time", "said_at"), [(np.inf, COUNT), (1.5, BEGIN), (1.5, COUNT)])
def test_what_is_left_out_has_never_been(forgetting_time: float, said_at: int) -> None:
    """Whenever it is said, and whatever was solved for, or written down, before."""
    of, asked = case(), []

    def after(count: int) -> None:
        if count % 78 == 0:
            asked.append(identifier.snapshot().rows)
            identifier.memory()
        if count >= said_at:
            identifier.leave_out("bad", BAD, BEGIN)

    identifier = begun(of, forgetting_time, COUNT)
    add(identifier, of.samples, after)
    assert_same(identifier, add(begun(of, forgetting_time, 0), without(of, BEGIN).samples))
    assert identifier.counts.rejected["bad"] == np.count_nonzero(np.isfinite(of.samples.effort[BEGIN:, BAD[0]]))
    assert identifier.counts.rejected[NOT_MEASURED] == np.count_nonzero(np.isnan(of.samples.effort))
    assert max(np.diff(asked)) > 0


def test_what_is_taken_again_is_there_as_if_nothing_had_been() -> None:
    """From some instant on, or all of it."""
    of, forgetting_time = case(), 1.5
    for end, expected in ((END, without(of, BEGIN, END)), (0, of)):
        identifier = add(begun(of, forgetting_time, COUNT), of.samples)
        assert identifier.leave_out("bad", BAD, BEGIN)
        assert not identifier.leave_out("bad", BAD, BEGIN + 50), "it is already"
        assert identifier.restore_rows("bad", end)
        assert not identifier.restore_rows("bad", end + 1), "it is already"
        assert_same(identifier, add(begun(of, forgetting_time, 0), expected.samples))


def test_other_channels_of_the_same_reason_are_left_out_as_well() -> None:
    of = case()
    effort = of.samples.effort.copy()
    effort[BEGIN:, 1] = effort[END:, 2] = np.nan
    identifier = add(begun(of, np.inf, COUNT), of.samples)
    assert identifier.leave_out("bad", (1,), BEGIN)
    assert identifier.leave_out("bad", (2,), END)
    assert not identifier.leave_out("bad", (1,), BEGIN), "it is already"
    assert_same(identifier, add(begun(of, np.inf, 0), of.with_efforts(effort).samples))
    assert identifier.restore_rows("bad", 0)
    assert_same(identifier, add(begun(of, np.inf, 0), of.samples))


def test_what_is_settled_stays() -> None:
    """Whether it was taken or left out by then."""
    of = case()
    identifier = add(begun(of, np.inf, COUNT), of.samples)
    for before in (40, 99, 100):  # many, and one alone
        identifier.settle(before)
    identifier.leave_out("bad", BAD, 0)
    identifier.settle(END)
    identifier.restore_rows("bad", 0)
    assert_same(identifier, add(begun(of, np.inf, 0), without(of, 100, END).samples))


def test_no_more_is_held_than_was_asked_for() -> None:
    """The last instants; and nothing, where nothing was asked for."""
    of = case()
    for hold in (0, 50):
        identifier = add(begun(of, np.inf, hold), of.samples)
        identifier.leave_out("bad", BAD, 0)
        assert_same(identifier, add(begun(of, np.inf, 0), without(of, COUNT - hold).samples))
    identifier = add(begun(of, np.inf, COUNT), of.samples)
    identifier.buffer_last(50)
    identifier.leave_out("bad", BAD, 0)
    assert_same(identifier, add(begun(of, np.inf, 0), without(of, COUNT - 50).samples))


@pytest.mark.parametrize("hold", [0, 5])
def test_what_is_left_out_stays_so_though_nothing_is_held(hold: int) -> None:
    """Until it is taken again."""
    of = case()
    identifier = add(begun(of, np.inf, COUNT), of.samples.select(slice(200)))
    identifier.leave_out("bad", BAD, 100)
    identifier.buffer_last(hold)
    add(identifier, of.samples.select(slice(200, 300)))
    identifier.restore_rows("bad", 300)
    add(identifier, of.samples.select(slice(300, None)))
    assert_same(identifier, add(begun(of, np.inf, 0), without(of, 100, 300).samples))


def restored(identifier: Identifier, of: Case, hold: int) -> Identifier:
    result = begun(of, np.inf, hold)
    result.restore(identifier.memory())
    return result


def test_what_another_life_knew_is_not_taken_back() -> None:
    of = case()
    first, second = of.samples.select(slice(200)), of.samples.select(slice(200, None))
    identifier = add(restored(add(begun(of, np.inf, COUNT), first), of, COUNT), second)
    identifier.leave_out("bad", BAD, 0)
    assert_same(identifier, add(begun(of, np.inf, 0), without(of, 200).samples))
