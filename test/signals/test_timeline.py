"""Which stamps continue a topic's time, and which begin another."""

from __future__ import annotations

import pytest

from geomid_ros.signals.messages import PoseMessage
from geomid_ros.signals.timeline import Timeline, Turn

from .feeding import START

MAX_GAP = 500_000_000
PERIOD = 10_000_000
LATE = START - 100 * MAX_GAP


def judged(*stamps: int) -> tuple[list[int], list[str], list[Turn], Timeline]:
    """What is used, why the others are refused, and the turns that time takes."""
    timeline, used, refused, turns = Timeline(MAX_GAP), [], [], []
    for stamp in stamps:
        found = timeline.judge(PoseMessage(stamp, [0.0] * 7))
        for message in found.use:
            timeline.advance(message.stamp)
            used.append(message.stamp)
        refused += found.refused
        turns += [found.turn] if found.turn is not Turn.CONTINUED else []
    return used, refused, turns, timeline


def run(begin: int, count: int, period: int = PERIOD) -> list[int]:
    return [begin + period * index for index in range(count)]


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_a_few_late_messages_are_no_clock_that_was_set_back(count: int) -> None:
    before, after = run(START, 20), run(START + 20 * PERIOD, 5)
    used, refused, turns, timeline = judged(*before, *run(LATE, count), *after)
    assert used == before + after
    assert refused == ["stamp too old"] * count
    assert (turns, timeline.held) == ([], 0)


def test_ten_late_messages_are_a_clock_that_was_set_back_and_are_used() -> None:
    before, after = run(START, 20), run(LATE, 30)
    used, refused, turns, _ = judged(*before, *after)
    assert (used, refused, turns) == (before + after, [], [Turn.RESET])


def test_one_message_from_the_future_is_refused_two_are_a_pause() -> None:
    before, later = run(START, 20), run(START + 10 * MAX_GAP, 2)
    after = run(START + 20 * PERIOD, 5)
    assert judged(*before, later[0], *after)[:3] == (before + after, ["stamp from the future"], [])
    assert judged(*before, *later)[:3] == (before + later, [], [Turn.PAUSE])


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_a_topic_slower_than_the_longest_gap_takes_three_messages_to_tell(count: int) -> None:
    before, slow = run(START, 1), run(START + 2 * MAX_GAP, count, 2 * MAX_GAP)
    used, refused, turns, timeline = judged(*before, *slow)
    assert not refused
    settled = 3 * (count // 3)
    assert used == before + slow[:settled]
    assert timeline.held == count - settled
    assert turns == [Turn.PAUSE] * (count // 3)


@pytest.mark.parametrize(
    ("stamp", "reason"),
    [(0, "stamp is zero"), (-1, "stamp is not valid"), (START, "stamp not later than the one before")],
)
def test_a_stamp_that_can_be_none_is_refused_at_once(stamp: int, reason: str) -> None:
    assert judged(START, stamp, START + PERIOD)[:2] == ([START, START + PERIOD], [reason])


def test_what_is_held_is_refused_in_the_end() -> None:
    timeline = judged(START, START + 10 * MAX_GAP)[3]
    assert timeline.held == 1
    assert timeline.release() == ["stamp from the future"]
    assert timeline.held == 0
