"""What a pipeline accepted lately, to look at it again."""

from __future__ import annotations

import threading
from collections import deque

from geomid_ros.signals.limits import BYTES_BESIDE_NUMBERS, MOST_BYTES
from geomid_ros.signals.messages import Accepted


class Recent:
    """Remembers what a pipeline accepted in the last ``seconds`` of its stamps: its ``on_accepted``.

    Less than that is kept where it would take too much memory. Any thread may call any method.
    """

    def __init__(self, seconds: float) -> None:
        self._lock = threading.RLock()
        self._nanoseconds = round(seconds * 1e9)
        self._entries: deque[Accepted] = deque()
        self._bytes = 0
        self._last: dict[str, int] = {}

    def __call__(self, accepted: Accepted) -> None:
        """Keep the numbers of messages."""
        topic, newest = accepted.topic, int(accepted.stamps[-1])
        with self._lock:
            if accepted.stamps[0] <= self._last.get(topic, 0):  # the clock was set back
                self.clear()
            self._last[topic] = newest
            self._entries.append(accepted)
            self._bytes += _size(accepted)
            while self._entries and (self._bytes > MOST_BYTES or self._is_old(self._entries[0], newest)):
                self._bytes -= _size(self._entries.popleft())

    def _is_old(self, accepted: Accepted, newest: int) -> bool:
        return bool(accepted.stamps[-1] <= newest - self._nanoseconds)

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entries.clear()
            self._last.clear()
            self._bytes = 0

    def entries(self) -> list[Accepted]:
        """All that is kept, in the order in which it came."""
        with self._lock:
            begin = max(self._last.values(), default=0) - self._nanoseconds + 1
            return [entry for each in self._entries if len(entry := each.since(begin))]


def _size(accepted: Accepted) -> int:
    return accepted.values.nbytes + accepted.stamps.nbytes + BYTES_BESIDE_NUMBERS
