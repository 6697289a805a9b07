"""Daemon threads, which may compute or wait for a disk when the process ends, and what a thread is doing."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import wait
from typing import Any

PATIENCE = 0.65
"""Time [s] for threads or a process to end. The node ends within two seconds: its worker, its last checkpoint and its
dashboard one after the other."""


def start_daemon(name: str, work: Callable[..., object], *arguments: Any) -> threading.Thread:
    """Start a daemon thread."""
    thread = threading.Thread(target=work, args=arguments, name=f"geomid-{name}", daemon=True)
    thread.start()
    return thread


def start_later(seconds: float, work: Callable[[], object]) -> None:
    """Run ``work`` in a daemon thread after a delay [s]."""
    timer = threading.Timer(seconds, work)
    timer.daemon = True
    timer.start()


def end_with_parent() -> None:
    """Start a daemon thread that ends this process when its parent ends, whatever it is doing."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            wait([parent.sentinel])
            os._exit(0)

    start_daemon("parent", watch)


class Activity:
    """Tracks what a thread is doing and for how long. The thread calls :meth:`doing`, others read :attr:`current`."""

    def __init__(self) -> None:
        self._begun: tuple[str, float] | None = None
        self._counted_from = 0.0

    @contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Mark the thread as doing ``what`` inside the context."""
        self._begun = what, time.monotonic()
        try:
            yield
        finally:
            self._begun = None

    @property
    def current(self) -> tuple[str, float]:
        """Present task of the thread, and the seconds since it began; an empty text and 0 while it waits."""
        task = self._begun
        return (task[0], time.monotonic() - max(task[1], self._counted_from)) if task else ("", 0.0)

    def restart_timer(self) -> None:
        """Restart the count of seconds, after whatever blocked the task was removed."""
        self._counted_from = time.monotonic()
