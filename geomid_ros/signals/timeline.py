"""Whether a message's stamp continues its topic's time, or another time begins."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np

from geomid_ros.signals.ledger import Reason
from geomid_ros.types import BoolArray, IntArray

NO_STAMP = "stamp is zero: whoever publishes has to fill in header.stamp"
NOT_LATER = Reason("stamp not later than the one before", "repeated")
_TO_CONFIRM_SLOWNESS = 3  # messages, each after a pause
_TO_CONFIRM_A_RESET = 10  # messages; a few late ones do not mean that a clock was set back


class Turn(Enum):
    """How a topic's time goes on."""

    CONTINUED = ""
    PAUSE = "pause: a new segment begins"
    RESET = "clock set back: a new segment begins"


class Stamped(Protocol):
    """A message."""

    @property
    def stamp(self) -> int:
        """[ns] since the epoch."""


T = TypeVar("T", bound=Stamped)


@dataclass
class Judged(Generic[T]):
    """The messages that are decided on: those to use, in order, and for each of the others the reason why not."""

    use: list[T] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    turn: Turn = Turn.CONTINUED


class Timeline(Generic[T]):
    """Judges the stamps of one topic.

    A message that is ahead or behind by more than ``max_gap`` [ns] is held until the next ones show what it was. If
    they go on from there it was a pause (one message shows it) or a clock that was set back; if they do not, a wrong
    stamp. On a topic slower than ``max_gap`` no message goes on from the one before: two more show the pause.
    """

    def __init__(self, max_gap: int) -> None:
        self._max_gap = max_gap
        self._last = 0
        self._held: list[T] = []

    @property
    def held(self) -> int:
        """Number of messages that are held."""
        return len(self._held)

    def later(self, stamps: IntArray, good: BoolArray) -> BoolArray | None:
        """Which of several messages are later than all before them.

        Args:
            stamps: ``(N,)`` [ns].
            good: ``(N,)`` which of them are used if they are later, so that :meth:`advance` will be called.

        Returns:
            ``(N,)``, the others are refused; None where messages must be judged one by one.
        """
        if self._held or np.min(stamps) <= 0:
            return None
        before = np.empty_like(stamps)
        before[0] = self._last
        before[1:] = np.maximum(np.maximum.accumulate(np.where(good, stamps, 0)[:-1]), self._last)
        ahead = stamps - before
        if np.any((np.abs(ahead) > self._max_gap) & (before > 0)):
            return None
        found: BoolArray = ahead > 0
        return found

    def judge(self, message: T) -> Judged[T]:
        """Take a message, and decide on it and on those that are held, as far as possible."""
        stamp = message.stamp
        if stamp <= 0:
            return Judged(refused=[NO_STAMP if stamp == 0 else "stamp is not valid"])
        ahead = stamp - self._last
        if self._last and not -self._max_gap <= ahead <= self._max_gap:
            return self._hold(message)
        judged: Judged[T] = Judged(refused=self.release())
        if ahead > 0:
            judged.use.append(message)
        else:
            judged.refused.append(NOT_LATER)
        return judged

    def _hold(self, message: T) -> Judged[T]:
        judged: Judged[T] = Judged()
        stamp = message.stamp
        back = stamp < self._last
        if self._held and self._held[-1].stamp - self._max_gap <= stamp <= self._held[-1].stamp:
            return Judged(refused=[NOT_LATER])
        while self._held and (stamp < self._held[-1].stamp or back != (self._held[-1].stamp < self._last)):
            judged.refused.append(self._reason(self._held.pop()))
        self._held.append(message)
        if self._is_confirmed(back):
            judged.turn = Turn.RESET if back else Turn.PAUSE
            judged.use, self._held = self._held, []
            if back:
                self._last = 0
        return judged

    def _is_confirmed(self, back: bool) -> bool:
        if back:
            return len(self._held) >= _TO_CONFIRM_A_RESET
        stamps = [message.stamp for message in self._held]
        return len(stamps) >= _TO_CONFIRM_SLOWNESS or (len(stamps) > 1 and stamps[1] - stamps[0] <= self._max_gap)

    def advance(self, stamp: int) -> None:
        """Note that a message with this stamp is used."""
        self._last = stamp

    def release(self) -> list[str]:
        """Refuse the messages that are held. Returns the reason for each."""
        reasons = [self._reason(message) for message in self._held]
        self._held.clear()
        return reasons

    def _reason(self, message: T) -> str:
        return "stamp from the future" if message.stamp > self._last else "stamp too old"

    def forget(self) -> list[T]:
        """Begin anew. Returns the messages that were held, to begin with."""
        held, self._held, self._last = self._held, [], 0
        return held
