"""Runs a search in a thread: one at a time; the end of the node does not wait for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from geomid_ros.errors import InputError
from geomid_ros.live.threads import start_daemon
from geomid_ros.options import Progress

_PATIENCE = 0.2  # [s] for a search to notice that it is to end


class Found(Protocol):
    """What a search finds."""

    @property
    def sentence(self) -> str:
        """In short."""

    @property
    def document(self) -> dict[str, Any]:
        """As a whole, for JSON."""


R = TypeVar("R", bound=Found)


@dataclass(frozen=True)
class SearchStatus(Generic[R]):
    """The state of a search in a ``sentence``; its ``stage`` while it runs, then its ``result``, or neither when it has
    failed."""

    sentence: str
    stage: str = ""
    result: R | None = None

    @property
    def document(self) -> dict[str, Any]:
        """What was found; only the sentence, as ``error``, when the search failed."""
        return self.result.document if self.result else {"error": self.sentence}


class _EndedError(Exception):
    """The search was closed."""


class BackgroundSearch(Generic[R]):
    """Looks for something."""

    def __init__(self, failure: str, on_end: Callable[[SearchStatus[R]], None]) -> None:
        """
        Args:
            failure: what is said of a search that found nothing, before the reason.
            on_end: ``on_end(status)`` is called in the search's thread when a search ends by itself.
        """
        self._failure = failure
        self._on_end = on_end
        self.status: SearchStatus[R] | None = None  # of the present or the last search
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()  # the present search, from outside
        self._lock = threading.Lock()  # held while on_end is called

    @property
    def running(self) -> bool:
        """Whether a search is going on; one that was ended does until it notices."""
        ending = self._ended.is_set() and self._thread is not None and self._thread.is_alive()
        return ending or (self.status is not None and self.status.stage != "")

    def start(self, look: Callable[[Progress], R]) -> None:
        """Begin a search: ``look(progress)``, in a thread."""
        self._ended = threading.Event()
        self._progress(self._ended, "beginning", 0.0)
        self._thread = start_daemon("search", self._run, look, self._ended)

    def close(self) -> None:
        """End the present search, without calling ``on_end``, and forget the last one."""
        with self._lock:
            self._ended.set()
            self.status = None
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def _run(self, look: Callable[[Progress], R], ended: threading.Event) -> None:
        try:
            result = look(partial(self._progress, ended))
            status = SearchStatus(result.sentence, result=result)
        except _EndedError:
            return
        except InputError as error:
            status = SearchStatus(f"{self._failure}: {error}")
        except Exception as error:  # noqa: BLE001 the caller must have an answer
            status = SearchStatus(f"{self._failure}: {type(error).__name__}: {error}")
        with self._lock:
            if not ended.is_set():
                self.status = status
                self._on_end(status)

    def _progress(self, ended: threading.Event, stage: str, share: float) -> None:
        with self._lock:
            if ended.is_set():
                raise _EndedError
            self.status = SearchStatus(f"running: {stage}, {100.0 * share:.0f} %", stage)
