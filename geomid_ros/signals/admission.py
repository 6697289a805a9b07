"""The front of the pipeline: messages go on in the order in which they came, decided on by the gate of their source.

While a message waits for the ones that show what it was, all that came after it, on any topic, wait behind it. So what
is behind the gates sees one sequence, however many messages come at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.arrived import Arrived
from geomid_ros.signals.gate import Gate
from geomid_ros.signals.messages import JOINT_STATES

Source: TypeAlias = tuple[str, tuple[str, ...]]
"""A topic, and if joint messages are merged, the joints of a publisher."""


class Admission:
    """Messages of several sources, each with a gate."""

    def __init__(self, new_gate: Callable[[Source], Gate], note: Callable[[str, str], None]) -> None:
        """
        Args:
            new_gate: makes the gate of a source.
            note: is told by the topic of what is doubtful, as it goes on.
        """
        self._new_gate = new_gate
        self._note = note
        self._gates: dict[Source, Gate] = {}
        self._waiting: dict[Source, Arrived] = {}  # messages that are decided on, behind others that are not
        self._changed: dict[int, tuple[Source, str]] = {}  # what has changed, by the place of the first message after
        self._noted: dict[int, tuple[Source, str]] = {}  # what is doubtful, by the place of its message

    @property
    def held(self) -> Counter[str]:
        """Number of messages that wait, by their topic."""
        found = Counter[str]()
        for source, gate in self._gates.items():
            found[source[0]] += gate.held + (len(self._waiting[source]) if source in self._waiting else 0)
        return found

    def take(
        self, new: Mapping[Source, Arrived], newest: int
    ) -> list[tuple[tuple[Source, str] | None, dict[Source, Arrived]]]:
        """Take messages, and let those go on that are decided on.

        Args:
            new: messages of each source, in the order in which they came.
            newest: the place of the last one that came, of any source.

        Returns:
            In which source something has changed, and what, and the messages that follow; None at first.
        """
        self._gates |= {source: self._new_gate(source) for source in new if source not in self._gates}
        for source in self._gates:
            self._decide(source, new.get(source), newest)
        result: list[tuple[tuple[Source, str] | None, dict[Source, Arrived]]] = []
        before = None
        while (place := min(self._changed, default=newest + 1)) < self._end(newest):
            result.append((before, self._before(place)))
            before = self._changed.pop(place)
            self._reconsider(before[0], place, newest)
        return [*result, (before, self._before(self._end(newest)))]

    def give_up(self) -> Counter[str]:
        """Give up the messages that are not decided on: others no longer wait for them. Returns how many they were, by
        their topic."""
        given_up = Counter[str]()
        for source, gate in self._gates.items():
            given_up[source[0]] += gate.held
            gate.give_up()
        return given_up

    def _end(self, newest: int) -> int:
        """The place of the first message that is not decided on."""
        return min([gate.first_held for gate in self._gates.values() if gate.held], default=newest + 1)

    def _decide(self, source: Source, arrived: Arrived | None, newest: int) -> None:
        decided = self._gates[source].judge(arrived, newest)
        if decided is None:
            return
        self._changed |= {place: (source, what) for place, what in decided.changed.items()}
        self._noted |= {place: (source, what) for place, what in decided.noted.items()}
        waiting = self._waiting.get(source)
        self._waiting[source] = decided.messages if waiting is None else Arrived.joined([waiting, decided.messages])

    def _reconsider(self, changed: Source, place: int, newest: int) -> None:
        """Decide anew on what has come on other topics since the clock of one was set: they may have the same clock."""
        for source, gate in self._gates.items():
            if source[0] in (changed[0], JOINT_STATES):  # the motion has told of the joints' clock
                continue
            waiting, since = self._waiting.pop(source, None), None
            if waiting is not None:
                first = int(np.searchsorted(waiting.order, place))
                self._waiting[source], since = waiting.select(slice(first)), waiting.select(slice(first, None))
            self._changed = {other: entry for other, entry in self._changed.items() if entry[0] != source}
            self._noted = {other: entry for other, entry in self._noted.items() if entry[0] != source}
            self._decide(source, gate.begin_anew(since), newest)

    def _before(self, place: int) -> dict[Source, Arrived]:
        """The messages that wait and came before this place; they wait no more."""
        for noted in sorted(other for other in self._noted if other < place):
            (topic, _), what = self._noted.pop(noted)
            self._note(topic, what)
        found = {}
        for source, waiting in [*self._waiting.items()]:
            count = int(np.searchsorted(waiting.order, place))
            found[source] = waiting.select(slice(count))
            if count < len(waiting):
                self._waiting[source] = waiting.select(slice(count, None))
            else:
                del self._waiting[source]
        return found
