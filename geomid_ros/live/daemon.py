"""Threads that the end of the process does not wait for: they may compute, or wait for a slow disk."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
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
