"""The ledger: counts what became of every message."""

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
Meaning: TypeAlias = Literal["", "driver error", "told", "note", "repeated", "frame", "joint"]


class Reason(str):
    """Reason why messages were not used, or a remark on them, in words. ``meaning`` is the consequence:

    - ``driver error``: the driver fills in its messages wrongly, so all of them are doubtful;
    - ``told``: reported to the user, though the other messages are usable; ``note``: reported, but as no warning;
    - ``frame``: a wrench is in another frame; ``joint``: a joint is missing;
    - ``repeated``: the driver may publish more often than it measures.
    """

    meaning: Meaning

    def __new__(cls, text: str, meaning: Meaning) -> Self:
        reason = super().__new__(cls, text)
        reason.meaning = meaning
        return reason

    @property
    def sentence(self) -> str:
        """Text without its heading."""
        return self.removeprefix(_HEADING)

    def __reduce__(self) -> tuple[Any, ...]:
        return Reason, (str(self), self.meaning)


def driver_error(sentence: str) -> Reason:
    """Return the reason for a message that the driver has filled in wrongly."""
    return Reason(_HEADING + sentence, "driver error")


def meaning_of(reason: str) -> Meaning:
    """Return the meaning of a reason; empty if it has none."""
    return reason.meaning if isinstance(reason, Reason) else ""


@dataclass
class Account:
    """Counts of a topic's messages.

    ``accepted``: used; ``rejected``, by reason: unusable for their content; ``dropped``, by reason: not processed.
    ``noted`` are remarks, mostly on accepted messages; ``lost``: published, but never received.
    """

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    noted: Counter[str] = field(default_factory=Counter)
    lost: int = 0

    @property
    def received(self) -> int:
        """Number of accepted, rejected and dropped messages."""
        return self.accepted + self.rejected.total() + self.dropped.total()

    def since(self, before: Account) -> Account:
        """Return the counts since the account was ``before``."""
        return Account(*map(operator.sub, vars(self).values(), vars(before).values()))

    def plus(self, other: Account) -> Account:
        """Return the sum of both counts."""
        return Account(*map(operator.add, vars(self).values(), vars(other).values()))


class Ledger:
    """Accounts of all topics. Every message is counted once, by :meth:`accept`, :meth:`reject` or :meth:`drop`.

    Any thread may call any method.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._topics: dict[str, Account] = {}

    @property
    def topics(self) -> dict[str, Account]:
        """Copy of the accounts by topic."""
        with self._lock:
            return copy.deepcopy(self._topics)

    def restore(self, accounts: Mapping[str, Account]) -> None:
        """Add the counts of an earlier process, unless this one has accepted or rejected messages."""
        with self._lock:
            if not any(account.accepted or account.rejected for account in self._topics.values()):
                self.add(accounts)

    def add(self, accounts: Mapping[str, Account]) -> None:
        """Add the counts of another ledger."""
        with self._lock:
            for topic, other in accounts.items():
                self._topics[topic] = self._account(topic).plus(other)

    def accept(self, topic: str, count: int = 1) -> None:
        """Count messages as used."""
        with self._lock:
            self._account(topic).accepted += count

    def reject(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages as unusable for their content."""
        with self._lock:
            count_reason(self._account(topic).rejected, reason, count)

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages as not processed."""
        with self._lock:
            count_reason(self._account(topic).dropped, reason, count)

    def revoke(self, topic: str, reason: str, count: int = 1) -> None:
        """Count accepted messages as rejected instead."""
        with self._lock:
            self.accept(topic, -count)
            self.reject(topic, reason, count)

    def note(self, topic: str, remark: str) -> None:
        """Count a remark."""
        with self._lock:
            count_reason(self._account(topic).noted, remark)

    def lose(self, topic: str, count: int) -> None:
        """Count messages as published but never received."""
        with self._lock:
            self._account(topic).lost += count

    def _account(self, topic: str) -> Account:
        return self._topics.setdefault(topic, Account())


def count_reason(reasons: Counter[str], reason: str, count: int = 1) -> None:
    """Count a reason ``count`` times. Long reasons are truncated; reasons beyond :data:`MOST_KINDS` count as one."""
    meaning, text = meaning_of(reason), one_line(reason)
    short = text if len(text) <= LONGEST_REASON else text[:LONGEST_REASON] + "..."
    short = Reason(short, meaning) if meaning else short
    reasons[short if short in reasons or len(reasons) < MOST_KINDS else _OTHER] += count
