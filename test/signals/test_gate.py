"""Which stamps continue a topic's time, and which begin another."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.signals.gates import FROM_THE_FUTURE, NOT_LATER, PAUSE, SET_BACK, TOO_OLD, Gate, ReorderBuffer
from geomid_ros.signals.message_batch import NO_MESSAGES, MessageBatch
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


BEFORE, AFTER, LATER = run(START, 20), run(START + 20 * PERIOD, 5), START + 10 * MAX_GAP
FAR, SLOW = START + 2 * MAX_GAP, run(START + 2 * MAX_GAP, 8, 2 * MAX_GAP)
JUDGED = {
    **{  # a few late messages are no clock that was set back
        f"{count} late": ([*BEFORE, *run(LATE, count), *AFTER], 0, (BEFORE + AFTER, [TOO_OLD] * count, [], 0))
        for count in (1, 2, 5, 9)
    },
    "a clock that was set back": (BEFORE + run(LATE, 30), 0, (BEFORE + run(LATE, 30), [], [SET_BACK], 0)),
    "one from the future": ([*BEFORE, LATER, *AFTER], 0, (BEFORE + AFTER, [FROM_THE_FUTURE], [], 0)),
    "two in the future": ([*BEFORE, *run(LATER, 2)], 0, (BEFORE + run(LATER, 2), [], [PAUSE], 0)),
    **{  # a topic slower than the longest gap takes two more messages to tell
        f"{count} slow": (
            [START, *SLOW[:count]], 0, ([START, *SLOW[:settled]], [], [PAUSE] * settled, count - settled)
        )
        for count, settled in ((1, 0), (2, 0), (3, 1), (8, 6))
    },
    "nearly decided": ([START, FAR], MESSAGES_UNTIL_DECISION - 1, ([START], [], [], 1)),
    "decided without more": ([START, FAR], MESSAGES_UNTIL_DECISION, ([START, FAR], [], [PAUSE], 0)),
    "one late, no more": ([START, LATE], MESSAGES_UNTIL_DECISION, ([START], [TOO_OLD], [], 0)),
    "two late, no more": (
        [START, *run(LATE, 2)], MESSAGES_UNTIL_DECISION, ([START, *run(LATE, 2)], [], [SET_BACK], 0)
    ),
    "the longest gap": ([START, START + MAX_GAP], 0, ([START, START + MAX_GAP], [], [], 0)),
    "a longer gap": ([START, START + MAX_GAP + 1], 0, ([START], [], [], 1)),
    "as far back": ([START, START - MAX_GAP], 0, ([START], [NOT_LATER], [], 0)),
    "farther back": ([START, START - MAX_GAP - 1], 0, ([START], [], [], 1)),
    "a pause is shown within the longest gap": (
        [START, LATER, LATER + MAX_GAP], 0, ([START, LATER, LATER + MAX_GAP], [], [PAUSE], 0)
    ),
    "and not beyond": ([START, LATER, LATER + MAX_GAP + 1], 0, ([START], [], [], 2)),
    "late and future ones confirm nothing": (
        [START, LATE, LATER, LATE], 0, ([START], [TOO_OLD, FROM_THE_FUTURE], [], 1)
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", JUDGED)
def test_which_stamps_pass(case: str) -> None:
    stamps, others, expected = JUDGED[case]
    assert judged(*stamps, others=others) == expected


@pytest.mark.parametrize("earlier", [0, 1, MAX_GAP])
def test_one_that_comes_again_or_late_confirms_no_pause(earlier: int) -> None:
    later = START + 10 * MAX_GAP
    used, refused, turns, held = judged(START, later, later - earlier)
    assert (used, turns, held + len(refused)) == ([START], [], 2)
    after = run(later + PERIOD, 3)
    assert judged(START, later, later - earlier, *after) == ([START, later, *after], [NOT_LATER], [PAUSE], 0)


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
