"""What a thread is at, and since when: for whoever watches over it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Duty:
    """One thread calls :meth:`on`, others ask for how long."""

    def __init__(self) -> None:
        self._begun: tuple[str, float] | None = None

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        """The thread is at ``what`` inside."""
        self._begun = what, time.monotonic()
        try:
            yield
        finally:
            self._begun = None

    @property
    def current(self) -> tuple[str, float]:
        """What the thread is at, and the seconds since it began; nothing and 0 while it waits."""
        begun = self._begun
        return (begun[0], time.monotonic() - begun[1]) if begun else ("", 0.0)
