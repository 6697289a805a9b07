"""Daemon threads, which may compute or wait for a disk when the process ends; what a thread is doing; and the queue of
the intake."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import wait
from typing import Any, NamedTuple, TypeAlias

from geomid_ros.signals.settings import MOST_WAITING, MOST_WAITING_BYTES

PATIENCE = 0.65
"""Time [s] for threads or a process to end. The node ends within two seconds: its worker, its last checkpoint and its
dashboard one after the other."""
MOST_AT_ONCE = 1000
"""Largest number of messages taken together before a request gets its turn."""


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


class Received(NamedTuple):
    """Message: its topic, its bytes, and the time [s] of its receipt on the clock of ``time.perf_counter``."""

    topic: str
    data: bytes
    time: float


Request: TypeAlias = Callable[[], None]
"""Task to run after the messages that came before it."""


class Inbox:
    """Queue from one thread that puts messages and requests to another that processes them."""

    def __init__(self) -> None:
        self._ready = threading.Condition()  # held briefly, for all fields
        self._tasks: deque[list[Received] | Request | None] = deque()  # None: the end
        self._waiting = self._bytes = 0  # of messages
        self.unfinished = 0
        """Number of messages that wait or are being processed."""

    def put_messages(self, messages: Sequence[Received]) -> Sequence[Received]:
        """Put messages in. Return the last ones, for which the queue has no room."""
        accepted: list[Received] = []
        with self._ready:
            for message in messages:
                if self._waiting >= MOST_WAITING or self._bytes > MOST_WAITING_BYTES:
                    break
                self._waiting, self._bytes = self._waiting + 1, self._bytes + len(message.data)
                accepted.append(message)
            self.unfinished += len(accepted)
            if accepted:
                self._put(accepted)
        return messages[len(accepted) :]

    def request(self, request: Request) -> None:
        """Put a request behind the waiting messages."""
        self._put(request)

    def end(self) -> None:
        """End the queue: tasks that are put in later are not processed."""
        self._put(None)

    def _put(self, task: list[Received] | Request | None) -> None:
        with self._ready:
            self._tasks.append(task)
            self._ready.notify()

    def clear(self) -> list[Received]:
        """Remove all tasks and end the queue. Return the messages."""
        with self._ready:
            batches = [task for task in self._tasks if isinstance(task, list)]
            self._tasks.clear()
            self.end()
        return [message for batch in batches for message in batch]

    def tasks(self) -> Iterator[list[Received] | Request]:
        """Yield tasks until the end. Waiting messages come as one batch. Asking for the next task finishes the previous
        one."""
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._tasks)
                task = self._tasks.popleft()
                if isinstance(task, list):
                    while len(task) < MOST_AT_ONCE and self._tasks and isinstance(more := self._tasks[0], list):
                        task += more
                        self._tasks.popleft()
                    self._waiting -= len(task)
                    self._bytes -= sum(len(message.data) for message in task)
            if task is None:
                return
            yield task
            if isinstance(task, list):
                with self._ready:
                    self.unfinished -= len(task)
