"""Whether a message's stamp continues its topic's time, or another time begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

from geomid_ros.types import FloatArray

Read: TypeAlias = Callable[[], FloatArray]
_TO_CONFIRM_SLOWNESS = 3  # messages, each a pause after the one before
_TO_CONFIRM_A_RESET = 10  # messages; a few late ones are no clock that was set back


class Turn(Enum):
    """How a topic's time goes on."""

    CONTINUED = ""
    PAUSE = "pause: a new segment begins"
    RESET = "clock set back: a new segment begins"


@dataclass
class Verdict:
    """Of the messages that have come to their end: those to use, in order, and how many are refused for what reason."""

    use: list[tuple[int, Read]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    turn: Turn = Turn.CONTINUED


class Timeline:
    """The stamps of one topic.

    A message that is ahead or behind by more than ``max_gap`` [ns] is held until the next ones tell what it was: when
    they go on from there, a pause (one is enough) or a clock that was set back; when they do not, a wrong stamp. Of a
    topic that is slower than ``max_gap``, no message goes on from the one before: that it pauses, two more tell.
    """

    def __init__(self, max_gap: int) -> None:
        self._max_gap = max_gap
        self._last = 0
        self._held: list[tuple[int, Read]] = []

    @property
    def held(self) -> int:
        """Messages whose fate is open."""
        return len(self._held)

    def judge(self, stamp: int, read: Read) -> Verdict:
        """Take a message by its ``stamp`` [ns] and what reads it."""
        if stamp <= 0:
            return Verdict(refused=["stamp is zero" if stamp == 0 else "stamp is not valid"])
        ahead = stamp - self._last
        if self._last and not -self._max_gap <= ahead <= self._max_gap:
            return self._hold(stamp, read)
        verdict = Verdict(refused=self.release())
        if ahead > 0:
            verdict.use.append((stamp, read))
        else:
            verdict.refused.append("stamp not later than the one before")
        return verdict

    def _hold(self, stamp: int, read: Read) -> Verdict:
        verdict, back = Verdict(), stamp < self._last
        if self._held and self._held[-1][0] - self._max_gap <= stamp <= self._held[-1][0]:
            return Verdict(refused=["stamp not later than the one before"])
        while self._held and (stamp < self._held[-1][0] or back != (self._held[-1][0] < self._last)):
            verdict.refused.append(self._reason(self._held.pop()[0]))
        self._held.append((stamp, read))
        if self._is_confirmed(back):
            verdict.turn = Turn.RESET if back else Turn.PAUSE
            verdict.use, self._held = self._held, []
            if back:
                self._last = 0
        return verdict

    def _is_confirmed(self, back: bool) -> bool:
        if back:
            return len(self._held) >= _TO_CONFIRM_A_RESET
        stamps = [stamp for stamp, _ in self._held]
        return len(stamps) >= _TO_CONFIRM_SLOWNESS or (len(stamps) > 1 and stamps[1] - stamps[0] <= self._max_gap)

    def advance(self, stamp: int) -> None:
        """A message with this stamp is used."""
        self._last = stamp

    def release(self) -> list[str]:
        """Let what is held go; the reason for each message."""
        reasons = [self._reason(stamp) for stamp, _ in self._held]
        self._held.clear()
        return reasons

    def _reason(self, stamp: int) -> str:
        return "stamp from the future" if stamp > self._last else "stamp too old"

    def forget(self) -> list[tuple[int, Read]]:
        """Begin anew, with what is held to begin with."""
        held, self._held, self._last = self._held, [], 0
        return held
