"""A gate decides on messages by those before and after them; this one by the order of their stamps.

What is refused depends on the messages of this stream alone, in the order in which they came; not on how many come at
once. A message that goes on from the one before passes at once. One that does not waits until others show what it was:
a fault that is soon over, a clock that was set, or something real, which passes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.signals.arrived import Arrived
from geomid_ros.signals.ledger import Reason
from geomid_ros.signals.limits import PATIENCE
from geomid_ros.types import FloatArray, IntArray

NOT_LATER = Reason("stamp not later than the one before", "repeated")
FROM_THE_FUTURE, TOO_OLD = "stamp from the future", "stamp too old"
_REASONS = (NOT_LATER, FROM_THE_FUTURE, TOO_OLD)
PAUSE = "pause: a new segment begins"
SET_BACK = "clock set back: a new segment begins"
_TO_CONFIRM_SLOWNESS = 3  # messages, each after a pause
_TO_CONFIRM_A_RESET = 10  # messages; a few late ones do not mean that a clock was set back


@dataclass(frozen=True)
class Answer:
    """What the first suspicious messages are, ``count`` of them: ``refused``, or real; something may have ``changed``
    from the first one on, and it may be ``noted``."""

    count: int = 1
    refused: str = ""
    changed: str = ""
    noted: str = ""


@dataclass(frozen=True, eq=False)
class Decided:
    """Messages that are decided on, refused ones with the reason; ``changed`` says by the place, as they came, of the
    first message that is different what has changed: nothing is to be compared across it; ``noted`` what is doubtful,
    and passes."""

    messages: Arrived
    changed: dict[int, str]
    noted: dict[int, str]


class Gate:
    """Decides on the messages of one source, by the order of their stamps.

    A message that is ahead by more than ``max_gap`` is after a pause if the next one is later by less than that, or, on
    a topic that is as slow, if two more are later. One that is behind by more begins another time if ten are in order.
    """

    def __init__(self, max_gap: int) -> None:
        """
        Args:
            max_gap: [ns] what is further apart is not compared.
        """
        self._max_gap = max_gap
        self._held: Arrived | None = None
        self._decided = 0  # stamp of the last message, good by itself, that was decided on
        self._stamp = 0  # of the last one that passed

    @property
    def held(self) -> int:
        """Number of messages that are held."""
        return 0 if self._held is None else len(self._held)

    @property
    def first_held(self) -> int:
        """The place of the first message that is held, if any is."""
        return int(self._held.order[0]) if self._held is not None else -1

    def judge(self, new: Arrived | None, newest: int) -> Decided | None:
        """Take messages, and decide on those that can be decided on.

        Args:
            new: messages; None to look again at those that are held.
            newest: the place of the last message of all topics.

        Returns:
            None if there is nothing to be decided on.
        """
        parts = [part for part in (self._held, new) if part is not None]
        if not parts:
            return None
        arrived = Arrived.joined(parts) if len(parts) > 1 else parts[0]
        changed, noted = dict[int, str](), dict[int, str]()
        good = np.flatnonzero(arrived.good)
        again = steps(arrived.stamps[good], self._decided) == 0
        arrived.refusals[good[again]] = NOT_LATER
        places = good[~again]
        stamps, numbers, order = arrived.stamps[places], arrived.numbers[places], arrived.order[places]
        place = self._pass_plain(stamps, numbers)
        while place < len(places):
            last = order[place] + PATIENCE
            window = slice(place, place + int(np.searchsorted(order[place:], last, side="right")))
            answer = self._answer(stamps[window], numbers[window], whole=newest >= last)
            if answer is None:
                break
            if answer.refused:
                arrived.refusals[places[place : place + answer.count]] = answer.refused
            else:
                if answer.changed:
                    changed[int(order[place])] = answer.changed
                    self._compare_anew()
                if answer.noted:
                    noted[int(order[place])] = answer.noted
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
            place += answer.count
            place += self._pass_plain(stamps[place:], numbers[place:])
        end = int(places[place]) if place < len(places) else len(arrived)
        decided = good[good < end]
        self._decided = int(arrived.stamps[decided[-1]]) if len(decided) else self._decided
        self._held = arrived.select(slice(end, None)) if end < len(arrived) else None
        return Decided(arrived.select(slice(end)), changed, noted)

    def give_up(self) -> None:
        """Give up the messages that are held."""
        self._held = None

    def begin_anew(self, decided: Arrived | None) -> Arrived | None:
        """Forget the time before. Returns the messages that were decided on since then, and those that are held, as
        they came."""
        parts = [part for part in (decided, self._held) if part is not None]
        self._held, self._stamp, self._decided = None, 0, 0
        if not parts:
            return None
        arrived = Arrived.joined(parts)
        arrived.refusals[[refusal in _REASONS for refusal in arrived.refusals]] = None
        return arrived

    def _pass_plain(self, stamps: IntArray, numbers: FloatArray) -> int:
        """Let messages pass that go on from those before, up to the first that does not. Returns how many passed."""
        if not len(stamps):
            return 0
        ahead = steps(stamps, self._stamp or int(stamps[0]) - 1)
        stops = np.flatnonzero((ahead <= 0) | (ahead > self._max_gap))
        count = int(stops[0]) if len(stops) else len(stamps)
        self._pass(stamps[:count], numbers[:count])
        return count

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:  # noqa: ARG002 for those that compare numbers
        """Note messages that go on from the one before, or are real though they do not."""
        if len(stamps):
            self._stamp = int(stamps[-1])

    def _compare_anew(self) -> None:
        """Something has changed: the next message is not compared with those before."""

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, whole: bool) -> Answer | None:  # noqa: ARG002
        """What the first of these messages, which does not go on from the one before, is; None if more have to come,
        and ``whole`` is not said."""
        first, *others = stamps.tolist()
        back = first <= self._stamp
        if self._stamp - self._max_gap <= first <= self._stamp:
            return Answer(refused=NOT_LATER)
        wrong = Answer(refused=TOO_OLD if back else FROM_THE_FUTURE)
        real = Answer(changed=SET_BACK) if back else Answer(noted=PAUSE)
        last, count = first, 1
        for stamp in others:
            if (stamp >= self._stamp - self._max_gap) if back else (stamp < first - self._max_gap):
                return wrong
            if not back and first < stamp <= first + self._max_gap:
                return real
            last, count = (stamp, count + 1) if stamp > last else (last, count)
            if count == (_TO_CONFIRM_A_RESET if back else _TO_CONFIRM_SLOWNESS):
                return real
        return None if not whole else wrong if back and count == 1 else real


def steps(stamps: IntArray, before: int) -> IntArray:
    """The steps to stamps ``(N,)``, the first one from the stamp ``before``."""
    result = stamps.copy()
    result[1:] -= stamps[:-1]
    result[:1] -= before
    return result
