"""A search in a thread: ended from outside it says nothing, and another can be started."""

from __future__ import annotations

import queue
import threading
from types import SimpleNamespace
from typing import Any

from geomid_ros.live.searches import BackgroundSearch
from geomid_ros.options import Progress

PATIENCE = 60.0  # [s]


def test_another_can_be_started_after_one_was_ended() -> None:
    told: queue.SimpleQueue[Any] = queue.SimpleQueue()
    search: BackgroundSearch[Any] = BackgroundSearch("nothing", told.put)
    ended, gone = threading.Event(), threading.Event()

    def look_on(progress: Progress) -> Any:
        try:
            while True:
                progress("looking", 0.5)
        finally:
            ended.wait(PATIENCE)
            gone.set()

    search.start(look_on)
    assert search.running
    search.close()
    assert search.status is None
    assert search.running, "it has not noticed yet"
    search.start(lambda _: SimpleNamespace(sentence="found"))
    assert told.get(timeout=PATIENCE).sentence == "found"
    ended.set()
    assert gone.wait(PATIENCE)
    assert search.status is not None
    assert search.status.sentence == "found"
    assert told.empty()
