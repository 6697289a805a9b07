"""Which stamps continue a topic's time, and which begin another."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.message_batch import NO_MESSAGES, MessageBatch
from geomid_ros.signals.reorder_buffer import FROM_THE_FUTURE, NOT_LATER, PAUSE, SET_BACK, TOO_OLD, Gate, ReorderBuffer
from geomid_ros.signals.settings import MESSAGES_UNTIL_DECISION

from .feeding import START

MAX_GAP = 500_000_000
PERIOD = 10_000_000
LATE = START - 100 * MAX_GAP


def judged(*stamps: int, others: int = 0) -> tuple[list[int], list[str], list[str], int]:
    """What passes, why the others are refused, the turns that time takes, and how many are held after so many
    messages of other topics."""
    notes: list[str] = []
    gate, used, refused, turns = Gate(MAX_GAP), [], [], []
    for place, stamp in enumerate([*stamps, *[None] * (others > 0)]):
        new = NO_MESSAGES
        if stamp is not None:
            new = MessageBatch(np.array([place]), np.array([stamp]), np.zeros((1, 6)), np.full(1, None))
        messages, noted = gate.decide(new, place if len(new) else place - 1 + others)
        used += messages.stamps[messages.is_usable].tolist()
        refused += messages.refusals[~messages.is_usable].tolist()
        turns += [answer.noted for answer in noted.values() if answer.begins]
        notes += [answer.noted for answer in noted.values() if not answer.begins]
    return used, refused, [*turns, *notes], len(gate.waiting)


def run(begin: int, count: int, period: int = PERIOD) -> list[int]:
    return [begin + period * index for index in range(count)]


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_a_few_late_messages_are_no_clock_that_was_set_back(count: int) -> None:
    before, after = run(START, 20), run(START + 20 * PERIOD, 5)
    assert judged(*before, *run(LATE, count), *after) == (before + after, [TOO_OLD] * count, [], 0)


def test_ten_late_messages_are_a_clock_that_was_set_back_and_are_used() -> None:
    before, after = run(START, 20), run(LATE, 30)
    assert judged(*before, *after) == (before + after, [], [SET_BACK], 0)


def test_one_message_from_the_future_is_refused_two_are_a_pause() -> None:
    before, later = run(START, 20), run(START + 10 * MAX_GAP, 2)
    after = run(START + 20 * PERIOD, 5)
    assert judged(*before, later[0], *after) == (before + after, [FROM_THE_FUTURE], [], 0)
    assert judged(*before, *later) == (before + later, [], [PAUSE], 0)


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_a_topic_slower_than_the_longest_gap_takes_two_more_messages_to_tell(count: int) -> None:
    slow = run(START + 2 * MAX_GAP, count, 2 * MAX_GAP)
    settled = max(count - 2, 0)
    assert judged(START, *slow) == ([START, *slow[:settled]], [], [PAUSE] * settled, min(count, 2))


def test_a_slow_topic_does_not_keep_others_waiting_for_ever() -> None:
    later = START + 2 * MAX_GAP
    assert judged(START, later, others=MESSAGES_UNTIL_DECISION - 1) == ([START], [], [], 1)
    assert judged(START, later, others=MESSAGES_UNTIL_DECISION) == ([START, later], [], [PAUSE], 0)


@pytest.mark.parametrize(("count", "expected"), [(1, ([START], [TOO_OLD], [], 0)),
                                                 (2, ([START, LATE, LATE + PERIOD], [], [SET_BACK], 0))])  # fmt: skip
def test_a_single_late_message_sets_no_clock_back_however_long_it_waits(count: int, expected: object) -> None:
    assert judged(START, *run(LATE, count), others=MESSAGES_UNTIL_DECISION) == expected


@pytest.mark.parametrize(("step", "is_held"), [(MAX_GAP, False), (MAX_GAP + 1, True)])
def test_a_pause_is_longer_than_the_longest_gap(step: int, is_held: bool) -> None:
    used, _, _, held = judged(START, START + step)
    assert (used, held) == ([START] if is_held else [START, START + step], is_held)
    _, refused, _, held = judged(START, START - step)
    assert (refused, held) == ([] if is_held else [NOT_LATER], is_held)


def test_the_one_that_shows_a_pause_is_within_the_longest_gap() -> None:
    later = START + 10 * MAX_GAP
    assert judged(START, later, later + MAX_GAP)[0] == [START, later, later + MAX_GAP]
    assert judged(START, later, later + MAX_GAP + 1)[0] == [START]


@pytest.mark.parametrize("earlier", [0, 1, MAX_GAP])
def test_one_that_comes_again_or_late_confirms_no_pause(earlier: int) -> None:
    later = START + 10 * MAX_GAP
    used, refused, turns, held = judged(START, later, later - earlier)
    assert (used, turns, held + len(refused)) == ([START], [], 2)
    after = run(later + PERIOD, 3)
    assert judged(START, later, later - earlier, *after) == ([START, later, *after], [NOT_LATER], [PAUSE], 0)


def test_late_ones_and_those_from_the_future_do_not_confirm_each_other() -> None:
    used, refused, turns, held = judged(START, LATE, START + 10 * MAX_GAP, LATE)
    assert (used, turns, held) == ([START], [], 1)
    assert refused == [TOO_OLD, FROM_THE_FUTURE]


def test_sources_go_on_in_the_order_in_which_they_came_first() -> None:
    """Whatever their names are: what is told of them, and what they wait for each other, does not change by chance."""
    sources = [(f"/wrench{number}", ()) for number in range(12)]
    admission = ReorderBuffer(lambda _: Gate(MAX_GAP), lambda *_: None)
    for begin in range(0, len(sources), 6):
        new = {
            source: MessageBatch(np.array([place]), np.array([START]), np.zeros((1, 6)), np.full(1, None))
            for place, source in enumerate(sources[begin : begin + 6], begin)
        }
        (admitted,) = admission.take(new, begin + 5)
    assert list(admitted) == sources
