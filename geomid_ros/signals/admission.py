"""The front of the pipeline: messages go on in the order in which they came, decided on by the gate of their source.

While a joint message waits for the ones that show what it was, all that came after it, on any topic, wait behind it. So
what is behind the gates sees one sequence, however many messages come at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

import numpy as np

from geomid_ros.signals.arrived import Arrived
from geomid_ros.signals.gates import JointGate

S = TypeVar("S")


class Admission(Generic[S]):
    """Messages of several sources of type ``S``, each with a gate or without one."""

    def __init__(self, new_gate: Callable[[S], JointGate | None]) -> None:
        """
        Args:
            new_gate: makes the gate of a source, where it has one.
        """
        self._new_gate = new_gate
        self._gates: dict[S, JointGate | None] = {}
        self._waiting: dict[S, Arrived] = {}  # messages that are decided on, behind others that are not
        self._changed: dict[int, tuple[S, str]] = {}  # what has changed, by the place of the first message after it

    @property
    def held(self) -> Counter[S]:
        """Number of messages that wait, by their source."""
        found = Counter({source: len(waiting) for source, waiting in self._waiting.items()})
        found.update({source: gate.held for source, gate in self._gates.items() if gate})
        return found

    def take(self, new: Mapping[S, Arrived], newest: int) -> list[tuple[dict[S, Arrived], tuple[S, str] | None]]:
        """Take messages, and let those go on that are decided on.

        Args:
            new: messages of each source, in the order in which they came.
            newest: the place of the last one that came, of any source.

        Returns:
            The messages that go on, and of which source something has changed just before the first of them, and what.
        """
        for source in new.keys() - self._gates.keys():
            self._gates[source] = self._new_gate(source)
        for source, gate in self._gates.items():
            self._decide(source, gate, new.get(source), newest)
        end = min([gate.first_held for gate in self._gates.values() if gate and gate.held], default=newest + 1)
        result: list[tuple[dict[S, Arrived], tuple[S, str] | None]] = []
        before = None
        for place in sorted(place for place in self._changed if place < end):
            result.append((self._before(place), before))
            before = self._changed.pop(place)
        return [*result, (self._before(end), before)]

    def forget(self) -> Counter[S]:
        """Give up all messages that wait. Returns how many they were, by their source."""
        held = self.held
        for gate in self._gates.values():
            if gate:
                gate.forget()
        self._waiting.clear()
        self._changed.clear()
        return held

    def _decide(self, source: S, gate: JointGate | None, arrived: Arrived | None, newest: int) -> None:
        if gate is not None:
            decided = gate.judge(arrived, newest)
            if decided is None:
                return
            arrived = decided.messages
            self._changed |= {place: (source, what) for place, what in decided.changed.items()}
        if arrived is not None:
            waiting = self._waiting.get(source)
            self._waiting[source] = arrived if waiting is None else Arrived.joined([waiting, arrived])

    def _before(self, place: int) -> dict[S, Arrived]:
        """The messages that wait and came before this place; they wait no more."""
        found = {}
        for source, waiting in [*self._waiting.items()]:
            count = int(np.searchsorted(waiting.order, place))
            found[source] = waiting.select(slice(count))
            if count < len(waiting):
                self._waiting[source] = waiting.select(slice(count, None))
            else:
                del self._waiting[source]
        return found
