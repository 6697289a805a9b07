"""Tracks what a thread is doing and for how long, for the watchdog and the diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Activity:
    """One thread calls :meth:`doing`, others ask :attr:`current`."""

    def __init__(self) -> None:
        self._begun: tuple[str, float] | None = None

    @contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """The thread does ``what`` inside."""
        self._begun = what, time.monotonic()
        try:
            yield
        finally:
            self._begun = None

    @property
    def current(self) -> tuple[str, float]:
        """What the thread does, and the seconds since it began; nothing and 0 while it waits."""
        begun = self._begun
        return (begun[0], time.monotonic() - begun[1]) if begun else ("", 0.0)
