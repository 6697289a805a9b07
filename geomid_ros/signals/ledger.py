"""The ledger: what became of every message."""

from __future__ import annotations

import copy
import operator
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self, TypeAlias

from geomid_ros.errors import one_line
from geomid_ros.signals.settings import LONGEST_REASON, MOST_KINDS

_OTHER = "other reasons"
_HEADING = "driver error: "
Meaning: TypeAlias = Literal["", "driver error", "told", "repeated", "frame"]


class Reason(str):
    """Why messages were not used, or what is peculiar about them, in words; ``meaning`` says what follows from it.

    ``driver error``: the driver fills in its messages wrongly, all of them are doubtful; ``told``: the user is told of
    it though the other messages can be used; ``repeated``: the driver may publish more often than it measures;
    ``frame``: a wrench is expressed in another one.
    """

    meaning: Meaning

    def __new__(cls, text: str, meaning: Meaning) -> Self:
        own = super().__new__(cls, text)
        own.meaning = meaning
        return own

    @property
    def sentence(self) -> str:
        """The text without its heading."""
        return self.removeprefix(_HEADING)

    def __reduce__(self) -> tuple[Any, ...]:
        return Reason, (str(self), self.meaning)


def driver_error(sentence: str) -> Reason:
    """The reason of a message that the driver has filled in wrongly."""
    return Reason(_HEADING + sentence, "driver error")


def meaning_of(reason: str) -> Meaning:
    """What follows from a reason."""
    return reason.meaning if isinstance(reason, Reason) else ""


@dataclass
class Account:
    """What became of the messages of a topic.

    ``accepted`` were used; ``rejected``, by reason, could not be for what they say; ``dropped``, by reason, were not
    looked at. ``noted`` are peculiarities, mostly of accepted messages; ``lost`` were published and never came.
    """

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    noted: Counter[str] = field(default_factory=Counter)
    lost: int = 0

    @property
    def received(self) -> int:
        """All that were accepted, rejected or dropped."""
        return self.accepted + self.rejected.total() + self.dropped.total()

    def since(self, before: Account) -> Account:
        """What was counted since the account was ``before``."""
        return Account(*map(operator.sub, vars(self).values(), vars(before).values()))

    def plus(self, other: Account) -> Account:
        """What both have counted."""
        return Account(*map(operator.add, vars(self).values(), vars(other).values()))


class Ledger:
    """The accounts of all topics. Every message is counted once, by :meth:`accept`, :meth:`reject` or :meth:`drop`.

    Any thread may call any method.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._topics: dict[str, Account] = {}

    @property
    def topics(self) -> dict[str, Account]:
        """A copy of the accounts by topic."""
        with self._lock:
            return copy.deepcopy(self._topics)

    def restore(self, accounts: Mapping[str, Account]) -> None:
        """Add what an earlier process counted, unless this one has accepted or rejected anything itself."""
        with self._lock:
            if not any(account.accepted or account.rejected for account in self._topics.values()):
                self.add(accounts)

    def add(self, accounts: Mapping[str, Account]) -> None:
        """Add what another ledger has counted."""
        with self._lock:
            for topic, other in accounts.items():
                self._topics[topic] = self._account(topic).plus(other)

    def accept(self, topic: str, count: int = 1) -> None:
        """Count messages that are used."""
        with self._lock:
            self._account(topic).accepted += count

    def reject(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages that cannot be used for what they say."""
        with self._lock:
            count_reason(self._account(topic).rejected, reason, count)

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages that are not looked at."""
        with self._lock:
            count_reason(self._account(topic).dropped, reason, count)

    def revoke(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages that were accepted as rejected."""
        with self._lock:
            self.accept(topic, -count)
            self.reject(topic, reason, count)

    def note(self, topic: str, remark: str) -> None:
        """Count a peculiarity."""
        with self._lock:
            count_reason(self._account(topic).noted, remark)

    def lose(self, topic: str, count: int) -> None:
        """Count messages that were published and never came."""
        with self._lock:
            self._account(topic).lost += count

    def _account(self, topic: str) -> Account:
        return self._topics.setdefault(topic, Account())


def count_reason(reasons: Counter[str], reason: str, count: int = 1) -> None:
    """Count a reason once more, or ``count`` times. Long reasons are cut short; those beyond a bound count as one."""
    meaning, text = meaning_of(reason), one_line(reason)
    short = text if len(text) <= LONGEST_REASON else text[:LONGEST_REASON] + "..."
    short = Reason(short, meaning) if meaning else short
    reasons[short if short in reasons or len(reasons) < MOST_KINDS else _OTHER] += count
