"""Stamps of one topic: what is used, what is held, and what shows that a clock was set back."""

from __future__ import annotations

import pytest

from geomid_ros.signals.messages import WrenchMessage
from geomid_ros.signals.validation import Judged, Timeline, Turn

GAP = 500  # [ns]
NOW = 100_000
TO_CONFIRM = 10  # messages of an earlier time


def message(stamp: int) -> WrenchMessage:
    return WrenchMessage("/wrench", stamp, "", (0.0,) * 6)


class Topic:
    """A timeline whose messages are all good."""

    def __init__(self, *stamps: int) -> None:
        self.timeline = Timeline(GAP)
        for stamp in stamps:
            self.push(stamp)

    def push(self, stamp: int) -> Judged:
        judged = self.timeline.judge(message(stamp))
        for used in judged.use:
            self.timeline.advance(used.stamp)
        return judged


def used(judged: Judged) -> list[int]:
    return [each.stamp for each in judged.use]


def test_what_goes_on_is_used_and_nothing_twice() -> None:
    topic = Topic()
    assert used(topic.push(NOW)) == [NOW]
    assert used(topic.push(NOW + GAP)) == [NOW + GAP]
    assert topic.push(NOW + GAP).refused == ["stamp not later than the one before"]
    assert topic.push(NOW).refused == ["stamp not later than the one before"]
    assert used(topic.push(NOW + GAP + 1)) == [NOW + GAP + 1]
    assert topic.timeline.held == 0


@pytest.mark.parametrize(("stamp", "reason"), [(0, "stamp is zero"), (-1, "stamp is not valid")])
def test_what_is_no_stamp_is_refused_and_changes_nothing(stamp: int, reason: str) -> None:
    topic = Topic(NOW)
    assert topic.push(stamp).refused == [reason]
    assert used(topic.push(NOW + 1)) == [NOW + 1]


def test_the_first_nanosecond_is_a_time() -> None:
    assert used(Topic().push(1)) == [1]


def test_nothing_less_than_ten_messages_shows_that_a_clock_was_set_back() -> None:
    """A few late ones do not; each is later than the one before it."""
    topic, begin = Topic(NOW), NOW // 2
    for count in range(1, TO_CONFIRM):
        judged = topic.push(begin + count)
        assert (judged.use, judged.refused, judged.turn) == ([], [], Turn.CONTINUED)
        assert topic.timeline.held == count
    judged = topic.push(begin + TO_CONFIRM)
    assert used(judged) == list(range(begin + 1, begin + TO_CONFIRM + 1))
    assert (judged.refused, judged.turn, topic.timeline.held) == ([], Turn.RESET, 0)
    assert used(topic.push(begin + TO_CONFIRM + 1)) == [begin + TO_CONFIRM + 1]


def test_late_messages_before_the_next_one_in_time_are_refused() -> None:
    topic = Topic(NOW, *range(NOW // 2, NOW // 2 + TO_CONFIRM - 1))
    judged = topic.push(NOW + 1)
    assert judged.refused == ["stamp too old"] * (TO_CONFIRM - 1)
    assert (used(judged), judged.turn, topic.timeline.held) == ([NOW + 1], Turn.CONTINUED, 0)


def test_one_message_that_goes_on_from_there_shows_a_pause() -> None:
    topic, later = Topic(NOW), 2 * NOW
    assert topic.push(later).use == []
    judged = topic.push(later + GAP)
    assert (used(judged), judged.turn) == ([later, later + GAP], Turn.PAUSE)
    assert topic.timeline.held == 0


def test_two_more_after_pauses_show_a_slow_topic() -> None:
    topic, step = Topic(NOW), GAP + 1
    assert [len(topic.push(NOW + count * step).use) for count in (1, 2)] == [0, 0]
    judged = topic.push(NOW + 3 * step)
    assert (used(judged), judged.turn) == ([NOW + count * step for count in (1, 2, 3)], Turn.PAUSE)


def test_just_longer_than_the_longest_gap_is_held_just_as_long_is_not() -> None:
    assert used(Topic(NOW).push(NOW + GAP)) == [NOW + GAP]
    assert used(Topic(NOW).push(NOW + GAP + 1)) == []
    assert Topic(NOW).push(NOW - GAP).refused == ["stamp not later than the one before"]
    assert Topic(NOW).push(NOW - GAP - 1).refused == []


def test_a_stamp_from_the_future_is_refused_when_time_goes_on_as_before() -> None:
    topic = Topic(NOW, 2 * NOW)
    judged = topic.push(NOW + 1)
    assert (used(judged), judged.refused) == ([NOW + 1], ["stamp from the future"])


def test_a_held_one_that_comes_again_or_late_is_refused_and_stays_held() -> None:
    topic = Topic(NOW, 2 * NOW)
    for stamp in (2 * NOW, 2 * NOW - GAP):
        assert topic.push(stamp).refused == ["stamp not later than the one before"]
    assert topic.timeline.held == 1
    assert used(topic.push(2 * NOW + 1)) == [2 * NOW, 2 * NOW + 1]


def test_an_earlier_one_shows_that_the_held_one_was_wrong() -> None:
    topic = Topic(NOW, 3 * NOW)
    judged = topic.push(2 * NOW)
    assert (judged.use, judged.refused) == ([], ["stamp from the future"])
    assert used(topic.push(2 * NOW + 1)) == [2 * NOW, 2 * NOW + 1]


def test_the_past_and_the_future_do_not_confirm_each_other() -> None:
    topic = Topic(NOW, NOW // 2)
    assert topic.push(2 * NOW).refused == ["stamp too old"]
    assert topic.push(NOW // 2).refused == ["stamp from the future"]
    assert topic.timeline.held == 1


def test_what_is_held_is_refused_at_the_end_and_begins_a_new_time() -> None:
    topic = Topic(NOW, 2 * NOW)
    assert topic.timeline.release() == ["stamp from the future"]
    assert topic.timeline.held == 0
    topic = Topic(NOW, NOW // 2)
    assert [each.stamp for each in topic.timeline.forget()] == [NOW // 2]
    assert topic.timeline.held == 0
    assert used(topic.push(7)) == [7]
