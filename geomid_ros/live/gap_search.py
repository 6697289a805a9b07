"""Runs the gap workflow in a thread: one search at a time; the end of the node does not wait for it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from geomid_ros.errors import InputError
from geomid_ros.files.models.gap_results import FORMAT, gap_document
from geomid_ros.files.models.judgements import causes_entry
from geomid_ros.gap.result import GapResult
from geomid_ros.live.daemon import start_daemon
from geomid_ros.plausibility.hypotheses import Finding
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.session.gap import find_in_messages
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import Accepted

_PATIENCE = 0.2  # [s] for a search to notice that it is to end


@dataclass(frozen=True)
class SearchStatus:
    """The state of a search in a ``sentence``; its ``stage`` while it runs, then its ``result``, or neither when it has
    failed; the ``causes`` that make it doubtful."""

    sentence: str
    stage: str = ""
    result: GapResult | None = None
    causes: Sequence[Finding] = ()

    @property
    def document(self) -> dict[str, Any]:
        """The document of ``gap.json``; only the sentence, as ``error``, when the search failed."""
        if not self.result:
            return {"format": FORMAT, "error": self.sentence}
        return gap_document(self.result, {}) | {"causes": causes_entry(self.causes)}


class _EndedError(Exception):
    """The search was closed."""


class GapSearch:
    """Looks for a gap."""

    def __init__(self, on_end: Callable[[SearchStatus], None]) -> None:
        """``on_end(status)`` is called in the search's thread when a search ends, unless it was closed before."""
        self._on_end = on_end
        self.status: SearchStatus | None = None  # of the present or the last search
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()  # held while on_end is called
        self._closed = False

    @property
    def running(self) -> bool:
        """Whether a search is going on."""
        return self.status is not None and self.status.stage != ""

    def start(self, make_session: Callable[[], Session], messages: Sequence[Accepted]) -> None:
        """Begin a search.

        Args:
            make_session: makes the session whose model is used, in the search's thread.
            messages: what the pipeline of another session has accepted.
        """
        self._progress("beginning", 0.0)
        self._thread = start_daemon("gap-search", self._run, make_session, messages)

    def close(self) -> None:
        """End, without calling ``on_end``."""
        with self._lock:
            self._closed = True
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def _run(self, make_session: Callable[[], Session], messages: Sequence[Accepted]) -> None:
        try:
            session = make_session()
            result = find_in_messages(session, messages, self._progress)
            status = SearchStatus(verdict_sentence(result), result=result, causes=session.findings)
        except _EndedError:
            return
        except InputError as error:
            status = SearchStatus(f"no finding: {error}")
        except Exception as error:  # noqa: BLE001 the caller must have an answer
            status = SearchStatus(f"no finding: {type(error).__name__}: {error}")
        with self._lock:
            if not self._closed:
                self.status = status
                self._on_end(status)

    def _progress(self, stage: str, share: float) -> None:
        if self._closed:
            raise _EndedError
        self.status = SearchStatus(f"looking: {stage}, {100.0 * share:.0f} %", stage)
