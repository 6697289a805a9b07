"""The front of the pipeline: messages go on in the order in which they came, decided on by the gate of their source.

A gate decides by the messages before and after. One that goes on from the one before passes at once; one that does not
waits until others show what it was: a fault that is soon over, a clock that was set, or something real, which passes.
All that came after it, on any topic, wait behind it: what is behind the gates sees one sequence, however many messages
come at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.arrived import NOTHING, Arrived
from geomid_ros.signals.clocks import steps
from geomid_ros.signals.ledger import Reason
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.settings import PATIENCE
from geomid_ros.types import FloatArray, IntArray

NOT_LATER = Reason("stamp not later than the one before", "repeated")
FROM_THE_FUTURE, TOO_OLD = "stamp from the future", "stamp too old"
_REASONS = (NOT_LATER, FROM_THE_FUTURE, TOO_OLD)
PAUSE = "pause: a new segment begins"
SET_BACK = "clock set back: a new segment begins"
FEW = 3  # messages in a row: a fault lasts no longer, and so many, each after a pause, are those of a slow topic
_TO_CONFIRM_A_RESET = 10  # messages; a few late ones do not mean that a clock was set back

Source: TypeAlias = tuple[str, tuple[str, ...]]
"""A topic, and the joints that its messages have if they are of joints."""


@dataclass(frozen=True)
class Answer:
    """What the first ``count`` suspicious messages are: ``refused``, or real. Something may be ``noted`` of the first;
    if it ``begins`` anew, nothing is to be compared across it."""

    count: int = 1
    refused: str = ""
    noted: str = ""
    begins: bool = False


class Gate:
    """Decides on the messages of one source, by the order of their stamps.

    What is refused depends on these alone, in the order in which they came; not on how many come at once. A message
    that is ahead by more than ``max_gap`` is after a pause if the next one is later by less than that, or, on a topic
    that is as slow, if two more are later. One that is behind by more begins another time if ten are in order.
    """

    def __init__(self, max_gap: int) -> None:
        """
        Args:
            max_gap: [ns] what is further apart is not compared.
        """
        self._max_gap = max_gap
        self.waiting = NOTHING
        """Messages that are not decided on."""
        self._decided = 0  # stamp of the last message, good by itself, that was decided on
        self._stamp = 0  # of the last one that passed

    def judge(self, new: Arrived, newest: int) -> tuple[Arrived, dict[int, Answer]]:
        """Take messages, and decide on those that can be decided on.

        Args:
            new: messages; none to look again at those that wait.
            newest: the place of the last message of all topics.

        Returns:
            Those that are decided on, refused ones with the reason; and what is noted, by the place of its message as
            they came.
        """
        arrived, notes = Arrived.joined([self.waiting, new]), dict[int, Answer]()
        good = np.flatnonzero(arrived.good)
        again = steps(arrived.stamps[good], self._decided) == 0
        arrived.refusals[good[again]] = NOT_LATER
        places = good[~again]
        plain = arrived if len(places) == len(arrived) else arrived.select(places)
        stamps, numbers, order = plain.stamps, plain.numbers, plain.order
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
                if answer.noted:
                    notes[int(order[place])] = answer
                if answer.begins:
                    self._compare_anew()
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
            place += answer.count
            place += self._pass_plain(stamps[place:], numbers[place:])
        end = int(places[place]) if place < len(places) else len(arrived)
        decided = good[good < end]
        self._decided = int(arrived.stamps[decided[-1]]) if len(decided) else self._decided
        found, self.waiting = arrived.divided(end)
        return found, notes

    def begin_anew(self, decided: Arrived) -> Arrived:
        """Forget the time before. Returns the messages that were decided on since then, and those that wait, as they
        came."""
        arrived = Arrived.joined([decided, self.waiting])
        self.waiting, self._stamp, self._decided = NOTHING, 0, 0
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
        real = Answer(noted=SET_BACK, begins=True) if back else Answer(noted=PAUSE)
        last, count = first, 1
        for stamp in others:
            if (stamp >= self._stamp - self._max_gap) if back else (stamp < first - self._max_gap):
                return wrong
            if not back and first < stamp <= first + self._max_gap:
                return real
            last, count = (stamp, count + 1) if stamp > last else (last, count)
            if count == (_TO_CONFIRM_A_RESET if back else FEW):
                return real
        return None if not whole else wrong if back and count == 1 else real


class Admission:
    """Messages of several sources, each with a gate."""

    def __init__(self, new_gate: Callable[[Source], Gate], note: Callable[[str, str], None]) -> None:
        """
        Args:
            new_gate: makes the gate of a source.
            note: is told by the topic of what has changed or is doubtful, as it goes on.
        """
        self._new_gate, self._note = new_gate, note
        self._gates: dict[Source, Gate] = {}
        self._decided: dict[Source, Arrived] = {}  # messages that wait behind others, which are not decided on
        self._notes: dict[int, tuple[Source, Answer]] = {}  # what is noted, by the place of its message

    @property
    def held(self) -> Counter[str]:
        """Number of messages that wait, by their topic."""
        found = Counter[str]()
        for source, gate in self._gates.items():
            found[source[0]] += len(gate.waiting) + len(self._decided[source])
        return found

    def take(self, new: Mapping[Source, Arrived], newest: int) -> list[dict[Source, Arrived]]:
        """Take messages, and let those go on that are decided on.

        Args:
            new: messages of each source, in the order in which they came.
            newest: the place of the last one that came, of any source.

        Returns:
            The messages that go on; with each part but the first something is another: a clock, or a unit.
        """
        for source in [source for source in new if source not in self._gates]:
            self._gates[source], self._decided[source] = self._new_gate(source), NOTHING
        for source in self._gates:
            self._decide(source, new.get(source, NOTHING), newest)
        result = []
        while (place := self._change(newest)) < self._end(newest):
            result.append(self._before(place))
            changed, answer = self._notes.pop(place)
            self._note(changed[0], answer.noted)
            self._reconsider(changed, place, newest)
        return [*result, self._before(self._end(newest))]

    def give_up(self) -> Counter[str]:
        """Give up the messages that are not decided on: others no longer wait for them. Returns how many they were, by
        their topic."""
        given_up = Counter[str]()
        for source, gate in self._gates.items():
            given_up[source[0]] += len(gate.waiting)
            gate.waiting = NOTHING
        return given_up

    def _change(self, newest: int) -> int:
        """The place of the first message from which on something is another."""
        return min((place for place, (_, answer) in self._notes.items() if answer.begins), default=newest + 1)

    def _end(self, newest: int) -> int:
        """The place of the first message that is not decided on."""
        waiting = [gate.waiting.order for gate in self._gates.values()]
        return min((int(order[0]) for order in waiting if len(order)), default=newest + 1)

    def _decide(self, source: Source, arrived: Arrived, newest: int) -> None:
        decided, notes = self._gates[source].judge(arrived, newest)
        self._notes |= {place: (source, answer) for place, answer in notes.items()}
        self._decided[source] = Arrived.joined([self._decided[source], decided])

    def _reconsider(self, changed: Source, place: int, newest: int) -> None:
        """Decide anew on what has come on other topics since the clock of one was set: they may have the same clock."""
        for source, gate in self._gates.items():
            if source[0] in (changed[0], JOINT_STATES):  # the motion has told of the joints' clock
                continue
            self._decided[source], since = self._decided[source].split(place)
            self._notes = {other: entry for other, entry in self._notes.items() if entry[0] != source}
            self._decide(source, gate.begin_anew(since), newest)

    def _before(self, place: int) -> dict[Source, Arrived]:
        """The messages that came before this place and are decided on; they wait no more."""
        for noted in sorted(other for other in self._notes if other < place):
            (topic, _), answer = self._notes.pop(noted)
            self._note(topic, answer.noted)
        found = {}
        for source, decided in self._decided.items():
            found[source], self._decided[source] = decided.split(place)
        return found
