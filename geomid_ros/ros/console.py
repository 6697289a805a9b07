"""Console messages on problems and progress, for users who do not watch the diagnostics."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Sequence

from geomid_ros.estimation.estimate import QUANTITIES, Estimate, LinkEstimate
from geomid_ros.live.status import Status
from geomid_ros.live.supervisor import Log
from geomid_ros.ros.diagnostics import MOST_LISTED, Advised, node_line

AGAIN = 60.0  # [s] until a sentence is logged again
_MOST_KINDS = 200  # bound on remembered sentences, as names in them are from outside


class Console:
    """Log in which every entry is one printable line, whatever names it contains.

    A complaint is logged if two diagnostics in a row have it, and then once a minute; its end, if two in a row no
    longer have it. One-off events are logged at once, and the same ones at most once a minute. Sentences that differ
    only in numbers are the same; those in names are no numbers.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._before: set[str] = set()  # kinds of complaints of the last diagnostics
        self._lasting: dict[str, str] = {}  # complaints that were logged, by kind, until they end
        self._logged: dict[str, float] = {}

    def info(self, *messages: str) -> None:
        """Log normal progress."""
        self._log.info(self._entry(messages))  # rclpy allows one severity per line of code

    def warning(self, *messages: str) -> None:
        """Log a problem that allows operation to continue."""
        self._log.warning(self._entry(messages))

    def error(self, *messages: str) -> None:
        """Log an error."""
        self._log.error(self._entry(messages))

    def log_complaints(self, errors: Sequence[str], warnings: Sequence[str], events: Iterable[str] = ()) -> None:
        """Take the complaints of the present diagnostics; log those that last, those that are one-off ``events``, and
        the end of those that were logged as they lasted."""
        before, present, at_once = self._before, set[str](), {*map(_kind, events)}
        for log, sentences in ((self.error, errors), (self.warning, warnings)):
            kinds = {_kind(sentence): sentence for sentence in sentences}
            due = [kind for kind in kinds if kind in before | at_once and self._was_long_ago(kind)]
            if due:
                log(*(kinds[kind] for kind in due))
            self._lasting |= {kind: kinds[kind] for kind in due if kind in before}
            present |= kinds.keys()
        ended = [kind for kind in self._lasting if kind not in before | present]
        if ended:
            self.info(f"no longer: {'; '.join(self._lasting.pop(kind) for kind in ended)}")
        self._before = present

    def log_events(self, sentences: Iterable[str]) -> None:
        """Log one-off events."""
        for sentence in sentences:
            if self._was_long_ago(_kind(sentence)):
                self.info(sentence)

    def _was_long_ago(self, kind: str) -> bool:
        return time.monotonic() - self._logged.get(kind, -AGAIN) >= AGAIN

    def _entry(self, sentences: Sequence[str]) -> str:
        """Return the entry of sentences that are logged now, and remember when."""
        self._logged |= dict.fromkeys(map(_kind, sentences), time.monotonic())
        while len(self._logged) > _MOST_KINDS:
            self._logged.pop(min(self._logged, key=self._logged.__getitem__))
        advised = (f"{text} ({text.advice})" if isinstance(text, Advised) else text for text in sentences)
        return node_line("; ".join(advised))


def _kind(sentence: str) -> str:
    return re.sub(r"\b\d+(\.\d+)?(e[-+]\d+)?", "#", sentence)


_MASS = QUANTITIES[0]


class StatusEvents:
    """Compares the present status with that of a second ago."""

    def __init__(self) -> None:
        self._before = Status(active=False)
        self._coming: dict[str, int] = {}  # consecutive seconds with data, by topic
        self._reported: set[str] | None = None  # links whose mass was reported; None before the first estimate

    def since(self, status: Status) -> Iterator[str]:
        """Yield sentences on what is new in the ``status`` of the next second."""
        accepted = {topic: account.accepted for topic, account in status.since(self._before).accounts.items()}
        self._before, estimate = status, status.estimate
        self._coming = {topic: self._coming.get(topic, 0) + 1 for topic, count in accepted.items() if count > 0}
        for topic in self._coming:
            if self._coming[topic] == 2:
                yield f"{status.name(topic)}: receiving {accepted[topic]} messages/s"
        if estimate is None:
            self._reported = None
            return
        identified = {link.name: link for link in estimate.links if _MASS in link.identified}
        if self._reported is None:
            self._reported = set()
            yield _first(estimate, identified.values())
        elif new := [link for name, link in identified.items() if name not in self._reported]:
            yield f"identified: {_list(map(_mass, new))}"
        self._reported.update(identified)


def _first(estimate: Estimate, identified: Iterable[LinkEstimate]) -> str:
    masses = _list(map(_mass, identified))
    rest = _list(link.name for link in estimate.links if _MASS not in link.identified)
    sentence = f"first estimate, from {estimate.rows_accepted} rows"
    sentence += f"; identified: {masses}" if masses else "; no mass is individually identifiable yet"
    return sentence + (f"; not identified yet: {rest}" if masses and rest else "")


def _mass(link: LinkEstimate) -> str:
    return f"{link.name} {link.mass:.3f} ± {link.std_mass:.3f} kg"


def _list(texts: Iterable[str]) -> str:
    names = [*texts]
    rest = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + rest
