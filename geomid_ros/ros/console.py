"""What is wrong and what gets on, on the console: for whoever does not watch the diagnostics."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence

from geomid_ros.errors import one_line
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
