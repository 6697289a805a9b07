"""Queue of the intake: batches of messages, and requests."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

from geomid_ros.signals.settings import MOST_WAITING, MOST_WAITING_BYTES

MOST_AT_ONCE = 1000
"""Largest number of messages taken together before a request gets its turn."""


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
        self._queue: queue.SimpleQueue[list[Received] | Request | None] = queue.SimpleQueue()
        self._put = self._put_bytes = 0  # of messages
        self._got = self._got_bytes = 0
        self._done = 0  # messages

    @property
    def unfinished(self) -> int:
        """Number of messages that wait or are being processed."""
        return self._put - self._done

    def put_messages(self, messages: Sequence[Received]) -> Sequence[Received]:
        """Put messages in. Return the last ones, for which the queue has no room."""
        accepted: list[Received] = []
        for message in messages[: max(0, MOST_WAITING - self._put + self._got)]:
            if self._put_bytes - self._got_bytes > MOST_WAITING_BYTES:
                break
            self._put_bytes += len(message.data)
            accepted.append(message)
        self._put += len(accepted)
        if accepted:
            self._queue.put(accepted)
        return messages[len(accepted) :]

    def request(self, request: Request) -> None:
        """Put a request behind the waiting messages."""
        self._queue.put(request)

    def end(self) -> None:
        """End the queue: tasks that are put in later are not processed."""
        self._queue.put(None)

    def clear(self) -> list[Received]:
        """Remove all tasks and end the queue. Return the messages."""
        messages: list[Received] = []
        while True:
            try:
                task = self._queue.get_nowait()
            except queue.Empty:
                break
            messages += task if isinstance(task, list) else []
        self.end()
        return messages

    def tasks(self) -> Iterator[list[Received] | Request]:
        """Yield tasks until the end. Waiting messages come as one batch. Asking for the next task finishes the previous
        one."""
        messages: list[Received] = []
        while True:
            try:
                task = self._queue.get(block=not messages)
            except queue.Empty:
                task = []
            if isinstance(task, list):
                messages += task
                self._got += len(task)
                self._got_bytes += sum(len(message.data) for message in task)
                if task and len(messages) < MOST_AT_ONCE:
                    continue
            if messages:
                yield messages
                self._done += len(messages)
                messages = []
            if task is None:
                return
            if not isinstance(task, list):
                yield task
