"""Threads that the end of the process does not wait for: they may compute, or wait for a slow disk."""

from __future__ import annotations

import threading
from collections.abc import Callable
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
