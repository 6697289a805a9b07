"""What waits for the intake: messages, many at once, and requests."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

from geomid_ros.signals.settings import MOST_WAITING, MOST_WAITING_BYTES

MOST_AT_ONCE = 1000
"""Messages that are taken together, before anything else has its turn."""


class Received(NamedTuple):
    """A message: its topic, its bytes, and when [s] it came, on the clock of ``time.perf_counter``."""

    topic: str
    data: bytes
    time: float


Request: TypeAlias = Callable[[], None]
"""Something to be done after the messages that came before."""


class Inbox:
    """One thread puts messages in, another takes them out and does what is asked."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[list[Received] | Request | None] = queue.SimpleQueue()
        self._put = self._put_bytes = 0  # of messages
        self._got = self._got_bytes = 0
        self._done = 0  # messages

    @property
    def unfinished(self) -> int:
        """Messages that wait, and those that were taken out last, until the next are asked for."""
        return self._put - self._done

    def put_messages(self, messages: Sequence[Received]) -> Sequence[Received]:
        """Put messages in. Returns those, the last ones, that have no room, as too many wait there."""
        taken: list[Received] = []
        for message in messages[: max(0, MOST_WAITING - self._put + self._got)]:
            if self._put_bytes - self._got_bytes > MOST_WAITING_BYTES:
                break
            self._put_bytes += len(message.data)
            taken.append(message)
        self._put += len(taken)
        if taken:
            self._queue.put(taken)
        return messages[len(taken) :]

    def ask(self, request: Request) -> None:
        """Put a request behind the messages that wait."""
        self._queue.put(request)

    def end(self) -> None:
        """Let nothing be taken out that is put in later."""
        self._queue.put(None)

    def clear(self) -> list[Received]:
        """Take out everything at once, and end. Returns the messages."""
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
        """What there is to do, until the end; messages that wait come together, and who asks for the next task is done
        with the last."""
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
