"""Threads that the end of the process does not wait for (they may compute, or wait for a disk), and what one does."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import wait
from typing import Any


def start_daemon(name: str, work: Callable[..., object], *arguments: Any) -> threading.Thread:
    """Start such a thread."""
    thread = threading.Thread(target=work, args=arguments, name=f"geomid-{name}", daemon=True)
    thread.start()
    return thread


def start_later(seconds: float, work: Callable[[], object]) -> None:
    """Start such a thread after a while."""
    timer = threading.Timer(seconds, work)
    timer.daemon = True
    timer.start()


def end_with_parent() -> None:
    """Start such a thread, which ends this process when its parent ends, whatever it is doing."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            wait([parent.sentinel])
            os._exit(0)

    start_daemon("parent", watch)


class Activity:
    """One thread calls :meth:`doing`, others ask :attr:`current`."""

    def __init__(self) -> None:
        self._begun: tuple[str, float] | None = None
        self._counted_from = 0.0

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
        return (begun[0], time.monotonic() - max(begun[1], self._counted_from)) if begun else ("", 0.0)

    def count_anew(self) -> None:
        """Count what it does from now on: what held it up was ended."""
        self._counted_from = time.monotonic()
