"""The last messages' numbers, to make other samples of them than those that were made when they came."""

from __future__ import annotations

import threading
from collections import deque

from geomid_ros.signals.pipeline import Accepted
from geomid_ros.types import FloatArray

_MOST_BYTES = 100_000_000
_BYTES_BESIDE_NUMBERS = 250  # of an entry


class Recent:
    """What a :class:`SignalPipeline` accepted in the last ``seconds`` of its stamps: its ``on_accepted``.

    Less than that is kept where it would take too much memory. Any thread may call any method.
    """

    def __init__(self, seconds: float) -> None:
        self._lock = threading.RLock()
        self._nanoseconds = round(seconds * 1e9)
        self._entries: deque[Accepted] = deque()
        self._bytes = 0
        self._last: dict[str, int] = {}

    def __call__(self, topic: str, stamp: int, values: FloatArray) -> None:
        """Keep the numbers of a message."""
        with self._lock:
            if stamp <= self._last.get(topic, 0):  # the clock was set back
                self.clear()
            self._last[topic] = stamp
            self._entries.append((topic, stamp, values))
            self._bytes += _size(values)
            while self._entries and (self._bytes > _MOST_BYTES or self._entries[0][1] <= stamp - self._nanoseconds):
                self._bytes -= _size(self._entries.popleft()[2])

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entries.clear()
            self._last.clear()
            self._bytes = 0

    def entries(self) -> list[Accepted]:
        """All that is kept, in the order in which it came."""
        with self._lock:
            return list(self._entries)


def _size(values: FloatArray) -> int:
    return values.nbytes + _BYTES_BESIDE_NUMBERS
