"""What is wrong and what gets on, on the console: for whoever does not watch the diagnostics."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Sequence

from geomid_ros.errors import one_line
from geomid_ros.estimation.estimate import Estimate, LinkEstimate
from geomid_ros.estimation.uncertain_inertia import QUANTITIES
from geomid_ros.live.status import Status
from geomid_ros.live.supervisor import Log
from geomid_ros.ros.diagnostics import Advised, Complaint

AGAIN = 60.0  # [s] until a sentence is said again
_MOST_KINDS = 200  # of sentences that are remembered: names in them are from outside


class Console:
    """A log in which every entry is one printable line, whatever names are in it.

    It says a complaint when it lasts, that is, when two diagnostics in a row have it; and once a minute while it does.
    News are said at once, the same ones once a minute. Sentences that differ in numbers only are the same.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._before: set[str] = set()
        self._said: dict[str, float] = {}

    def info(self, message: str, /) -> None:
        """Log what is as it should be."""
        self._log.info(one_line(message))

    def warning(self, message: str, /) -> None:
        """Log what is not, but can be lived with."""
        self._log.warning(one_line(message))

    def error(self, message: str, /) -> None:
        """Log what is wrong."""
        self._log.error(one_line(message))

    def tell(self, complaints: Sequence[Complaint]) -> None:
        """Take what the present diagnostics complain of."""
        kinds = {_kind(complaint.sentence): complaint for complaint in complaints}
        for error in (True, False):
            new = [kind for kind, found in kinds.items() if found.error is error and self._is_due(kind)]
            if new:
                sentences = [_with_hint(kinds[kind].sentence) for kind in new]
                (self.error if error else self.warning)("; ".join(sentences))
                self._remember(new)
        self._before = set(kinds)

    def tell_news(self, sentences: Iterable[str]) -> None:
        """Take what is new."""
        for sentence in sentences:
            if self._was_long_ago(_kind(sentence)):
                self.info(sentence)
                self._remember([_kind(sentence)])

    def _is_due(self, kind: str) -> bool:
        return kind in self._before and self._was_long_ago(kind)

    def _was_long_ago(self, kind: str) -> bool:
        return time.monotonic() - self._said.get(kind, -AGAIN) >= AGAIN

    def _remember(self, kinds: Iterable[str]) -> None:
        self._said |= dict.fromkeys(kinds, time.monotonic())
        while len(self._said) > _MOST_KINDS:
            self._said.pop(min(self._said, key=self._said.__getitem__))


def _kind(sentence: str) -> str:
    return re.sub(r"\d+", "#", sentence)


def _with_hint(sentence: str) -> str:
    return f"{sentence} ({sentence.advice})" if isinstance(sentence, Advised) else sentence


_MASS = QUANTITIES[0]
_MOST_NAMES = 8


class News:
    """Compares the status of one second with that of the second before."""

    def __init__(self) -> None:
        self._before = Status(active=False)
        self._coming: dict[str, int] = {}  # topics, and for how many seconds in a row there are data on them
        self._told: set[str] | None = None  # links whose mass has been told; None before the first estimate

    def since(self, status: Status) -> Iterator[str]:
        """Sentences on what is new in the status of another second."""
        accepted = {topic: account.accepted for topic, account in status.since(self._before).accounts.items()}
        self._before = status
        self._coming = {topic: self._coming.get(topic, 0) + 1 for topic, count in accepted.items() if count > 0}
        yield from (
            f"{topic}: receiving {accepted[topic]} messages/s" for topic in self._coming if self._coming[topic] == 2
        )
        yield from self._estimated(status.estimate)

    def _estimated(self, estimate: Estimate | None) -> Iterator[str]:
        if estimate is None:
            self._told = None
            return
        told = {link.name: link for link in estimate.links if _MASS in link.identified}
        if self._told is None:
            self._told = set(told)
            yield _first(estimate, told.values())
        elif new := [link for name, link in told.items() if name not in self._told]:
            self._told.update(told)
            yield f"identified: {_list(map(_mass, new))}"


def _first(estimate: Estimate, told: Iterable[LinkEstimate]) -> str:
    known = _list(map(_mass, told))
    rest = _list(link.name for link in estimate.links if _MASS not in link.identified)
    sentence = f"first estimate, from {estimate.rows_accepted} rows"
    sentence += f"; identified: {known}" if known else "; no mass is individually identifiable yet"
    return sentence + (f"; not identified yet: {rest}" if known and rest else "")


def _mass(link: LinkEstimate) -> str:
    return f"{link.name} {link.mass:.3f} ± {link.std_mass:.3f} kg"


def _list(texts: Iterable[str]) -> str:
    names = [*texts]
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
