"""First stage of the pipeline: gates decide which messages are admitted, in their order of arrival.

A gate decides by the messages before and after. A message that continues the one before passes at once. Any other waits
until later ones show what it is: a short fault, a clock that was set, or something real, which passes. All later
messages, on any topic, wait behind it. So the stages after the gates see one sequence, however messages are batched.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.clocks import steps
from geomid_ros.signals.ledger import Reason
from geomid_ros.signals.message_batch import NO_MESSAGES, MessageBatch
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.settings import MESSAGES_UNTIL_DECISION
from geomid_ros.types import BoolArray, FloatArray, IntArray

NOT_LATER = Reason("stamp not later than the one before", "repeated")
FROM_THE_FUTURE, TOO_OLD = "stamp from the future", "stamp too old"
_REASONS = (NOT_LATER, FROM_THE_FUTURE, TOO_OLD)
PAUSE = "pause: a new segment begins"
SET_BACK = "clock set back: a new segment begins"
FEW = 3  # messages of the longest fault; so many in order, each after a pause, show a slow topic
_TO_CONFIRM_A_RESET = 10  # messages, as a few late ones do not mean that a clock was set back

Source: TypeAlias = tuple[str, tuple[str, ...]]
"""A topic, and for joint messages their joints."""


@dataclass(frozen=True)
class GateDecision:
    """Decision on the first ``count`` suspicious messages: ``refused`` for a reason, or real. ``noted`` is a remark on
    the first; if it ``begins`` a new segment, nothing is compared across it."""

    count: int
    refused: str = ""
    noted: str = ""
    begins: bool = False


class Gate:
    """Decides on the messages of one source by the order of their stamps.

    Decisions depend on the messages and their order of arrival, not on their batches. A stamp that is ahead by more
    than ``max_gap`` follows a pause if the next one is later by less than that or, on a slow topic, if two more are
    later. A stamp that is behind by more shows a clock that was set back if ten are in order.
    """

    def __init__(self, max_gap: int) -> None:
        """
        Args:
            max_gap: [ns] messages further apart are not compared.
        """
        self._max_gap = max_gap
        self.waiting = NO_MESSAGES
        """Messages without a decision."""
        self._decided = 0  # stamp of the last decided message that is good by itself
        self._stamp = 0  # of the last message that passed

    def decide(self, new: MessageBatch, newest: int) -> tuple[MessageBatch, dict[int, GateDecision]]:
        """Take messages, and decide on those that can be decided.

        Args:
            new: messages; none to look again at the waiting ones.
            newest: arrival index of the last message of all topics.

        Returns:
            Decided messages, refused ones with the reason; and remarks by the arrival index of their message.
        """
        arrived, notes = MessageBatch.joined([self.waiting, new]), dict[int, GateDecision]()
        good = np.flatnonzero(arrived.is_usable)
        repeated = steps(arrived.stamps[good], self._decided) == 0
        arrived.refusals[good[repeated]] = NOT_LATER
        places = good[~repeated]
        plain = arrived if len(places) == len(arrived) else arrived.select(places)
        stamps, numbers, order = plain.stamps, plain.numbers, plain.order
        place = self._pass_plain(stamps, numbers)
        while place < len(places):
            last = order[place] + MESSAGES_UNTIL_DECISION
            window = slice(place, place + int(np.searchsorted(order[place:], last, side="right")))
            answer = self._answer(stamps[window], numbers[window], final=newest >= last)
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
        decided_indices = good[good < end]
        self._decided = int(arrived.stamps[decided_indices[-1]]) if len(decided_indices) else self._decided
        decided, self.waiting = arrived.split_after(end)
        return decided, notes

    def begin_anew(self, decided: MessageBatch) -> MessageBatch:
        """Reset the gate. Return the ``decided`` messages, which must be decided on again, and the waiting ones,
        without its refusals."""
        arrived = MessageBatch.joined([decided, self.waiting])
        self.waiting, self._stamp, self._decided = NO_MESSAGES, 0, 0
        arrived.refusals[[refusal in _REASONS for refusal in arrived.refusals]] = None
        return arrived

    def _pass_plain(self, stamps: IntArray, numbers: FloatArray) -> int:
        """Pass messages that continue those before, up to the first that does not. Return how many passed."""
        place = 0
        while place < len(stamps):
            if not self._stamp:  # the first message of all has none to continue
                self._pass(stamps[:1], numbers[:1])
                place = 1
            part = slice(place, place + self._room)
            stops = np.flatnonzero(self._suspicious(stamps[part], numbers[part]))
            count = int(stops[0]) if len(stops) else len(stamps[part])
            self._pass(stamps[place : place + count], numbers[place : place + count])
            place += count
            if len(stops):
                break
        return place

    @property
    def _room(self) -> int:
        """Number of messages that can be compared at once: until something is learned of them."""
        return MESSAGES_UNTIL_DECISION

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> BoolArray:  # noqa: ARG002
        """True for messages ``(N,)`` that do not continue the one before, assuming that it passes."""
        ahead = steps(stamps, self._stamp)
        return (ahead <= 0) | (ahead > self._max_gap)

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:  # noqa: ARG002 for gates that compare numbers
        """Record messages that pass: they continue the one before, or are real although they do not."""
        if len(stamps):
            self._stamp = int(stamps[-1])

    def _compare_anew(self) -> None:
        """Restart comparisons: the next message is not compared with earlier ones."""

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, final: bool) -> GateDecision | None:  # noqa: ARG002
        """Decide on the first of these messages, which does not continue the one before. Return None if more messages
        are needed and this call is not ``final``."""
        first, *later = stamps.tolist()
        back = first <= self._stamp
        if self._stamp - self._max_gap <= first <= self._stamp:
            return GateDecision(1, refused=NOT_LATER)
        wrong = GateDecision(1, refused=TOO_OLD if back else FROM_THE_FUTURE)
        real = GateDecision(1, noted=SET_BACK, begins=True) if back else GateDecision(1, noted=PAUSE)
        last, count = first, 1
        for stamp in later:
            if (stamp >= self._stamp - self._max_gap) if back else (stamp < first - self._max_gap):
                return wrong
            if not back and first < stamp <= first + self._max_gap:
                return real
            last, count = (stamp, count + 1) if stamp > last else (last, count)
            if count == (_TO_CONFIRM_A_RESET if back else FEW):
                return real
        return None if not final else wrong if back and count == 1 else real


@dataclass(eq=False)
class ReorderBuffer:
    """Admits the messages of several sources, with a gate for each.

    Attributes:
        new_gate: makes the gate of a source.
        note: ``note(topic, remark)`` receives changes and doubts as they are found.
    """

    new_gate: Callable[[Source], Gate]
    note: Callable[[str, str], None]
    _gates: dict[Source, Gate] = field(default_factory=dict)
    _decided: dict[Source, MessageBatch] = field(default_factory=dict)  # decided ones that wait behind undecided ones
    _notes: dict[int, tuple[Source, GateDecision]] = field(default_factory=dict)  # by their message's arrival index

    @property
    def waiting_counts(self) -> Counter[str]:
        """Number of waiting messages by topic."""
        counts = Counter[str]()
        for source, gate in self._gates.items():
            counts[source[0]] += len(gate.waiting) + len(self._decided[source])
        return counts

    def take(self, new: Mapping[Source, MessageBatch], newest: int) -> list[dict[Source, MessageBatch]]:
        """Take messages, and release those that are decided.

        Args:
            new: messages of each source, in their order of arrival.
            newest: arrival index of the last message of any source.

        Returns:
            The released messages; each part after the first begins a new segment, as a clock was set or positions
            leapt.
        """
        for source in [source for source in new if source not in self._gates]:
            self._gates[source], self._decided[source] = self.new_gate(source), NO_MESSAGES
        for source in self._gates:
            self._decide(source, new.get(source, NO_MESSAGES), newest)
        parts = []
        while (place := self._change(newest)) < self._end(newest):
            parts.append(self._before(place))
            changed, answer = self._notes.pop(place)
            self.note(changed[0], answer.noted)
            self._reconsider(changed, place, newest)
        return [*parts, self._before(self._end(newest))]

    def give_up(self) -> Counter[str]:
        """Drop the undecided messages, so that others no longer wait for them. Return their numbers by topic."""
        dropped = Counter[str]()
        for source, gate in self._gates.items():
            dropped[source[0]] += len(gate.waiting)
            gate.waiting = NO_MESSAGES
        return dropped

    def _change(self, newest: int) -> int:
        """Arrival index of the first message that begins a new segment."""
        return min((place for place, (_, answer) in self._notes.items() if answer.begins), default=newest + 1)

    def _end(self, newest: int) -> int:
        """Arrival index of the first undecided message."""
        waiting = [gate.waiting.order for gate in self._gates.values()]
        return min((int(order[0]) for order in waiting if len(order)), default=newest + 1)

    def _decide(self, source: Source, arrived: MessageBatch, newest: int) -> None:
        decided, notes = self._gates[source].decide(arrived, newest)
        self._notes |= {place: (source, answer) for place, answer in notes.items()}
        self._decided[source] = MessageBatch.joined([self._decided[source], decided])

    def _reconsider(self, changed: Source, place: int, newest: int) -> None:
        """Decide again on messages of other topics since a clock was set, as they may have the same clock."""
        for source, gate in self._gates.items():
            if source[0] in (changed[0], JOINT_STATES):  # joint states show their clock by the motion
                continue
            self._decided[source], since = self._decided[source].split(place)
            self._notes = {other: entry for other, entry in self._notes.items() if entry[0] != source}
            self._decide(source, gate.begin_anew(since), newest)

    def _before(self, place: int) -> dict[Source, MessageBatch]:
        """Release the decided messages that arrived before this one."""
        for noted in sorted(index for index in self._notes if index < place):
            (topic, _), answer = self._notes.pop(noted)
            self.note(topic, answer.noted)
        released = {}
        for source, decided in self._decided.items():
            released[source], self._decided[source] = decided.split(place)
        return released
