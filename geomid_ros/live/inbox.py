"""Queue of the intake: batches of messages, and requests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from threading import Condition
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
        self._ready = Condition()  # held briefly, for all fields
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
