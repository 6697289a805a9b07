"""Which stamps continue a topic's time, and which begin another."""

from __future__ import annotations

import pytest

from geomid_ros.signals.messages import PoseMessage
from geomid_ros.signals.timeline import NO_STAMP, Timeline, Turn

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
    [(0, NO_STAMP), (-1, "stamp is not valid"), (START, "stamp not later than the one before")],
)
def test_a_stamp_that_can_be_none_is_refused_at_once(stamp: int, reason: str) -> None:
    assert judged(START, stamp, START + PERIOD)[:2] == ([START, START + PERIOD], [reason])


def test_what_is_held_is_refused_in_the_end() -> None:
    timeline = judged(START, START + 10 * MAX_GAP)[3]
    assert timeline.held == 1
    assert timeline.release() == ["stamp from the future"]
    assert timeline.held == 0


@pytest.mark.parametrize(("step", "is_held"), [(MAX_GAP, False), (MAX_GAP + 1, True)])
def test_a_pause_is_longer_than_the_longest_gap(step: int, is_held: bool) -> None:
    used, _, _, timeline = judged(START, START + step)
    assert (used, timeline.held) == ([START] if is_held else [START, START + step], is_held)
    _, refused, _, timeline = judged(START, START - step)
    assert (refused, timeline.held) == ([] if is_held else ["stamp not later than the one before"], is_held)


def test_the_one_that_shows_a_pause_is_within_the_longest_gap() -> None:
    later = START + 10 * MAX_GAP
    assert judged(START, later, later + MAX_GAP)[0] == [START, later, later + MAX_GAP]
    assert judged(START, later, later + MAX_GAP + 1)[0] == [START]


@pytest.mark.parametrize("earlier", [0, 1, MAX_GAP])
def test_a_held_one_that_comes_again_or_late_is_refused_and_confirms_nothing(earlier: int) -> None:
    later = START + 10 * MAX_GAP
    used, refused, _, timeline = judged(START, later, later - earlier)
    assert (used, refused, timeline.held) == ([START], ["stamp not later than the one before"], 1)


def test_an_earlier_one_shows_that_the_held_one_was_wrong() -> None:
    later, latest = START + 10 * MAX_GAP, START + 20 * MAX_GAP
    used, refused, turns, _ = judged(START, latest, later, later + 1)
    assert (used, refused, turns) == ([START, later, later + 1], ["stamp from the future"], [Turn.PAUSE])


def test_late_ones_and_those_from_the_future_do_not_confirm_each_other() -> None:
    used, refused, turns, timeline = judged(START, LATE, START + 10 * MAX_GAP, LATE)
    assert (used, turns, timeline.held) == ([START], [], 1)
    assert refused == ["stamp too old", "stamp from the future"]


def test_a_new_time_begins_with_what_was_held() -> None:
    timeline = judged(START, LATE)[3]
    assert [message.stamp for message in timeline.forget()] == [LATE]
    assert timeline.held == 0
    assert [message.stamp for message in timeline.judge(PoseMessage(1, [0.0] * 7)).use] == [1]
