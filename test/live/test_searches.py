"""A search in a thread: ended from outside it says nothing, and another can be started."""

from __future__ import annotations

import queue
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.live import searches
from geomid_ros.live.searches import BackgroundSearch, FoundGap, PayloadSearch
from geomid_ros.options import Progress
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages, Recent

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


def test_a_doubtful_gap_says_so_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is only suspected is no doubt."""
    monkeypatch.setattr(searches, "verdict_sentence", lambda _: "Found: nothing.")
    faults = [
        RecordingFault(cause=Cause(kind="sign", sentence=sentence), sure=sure)
        for sentence, sure in (("reversed", True), ("perhaps late", False))
    ]
    result: Any = None
    assert FoundGap(result, faults, compared="with it").sentence == "DOUBTFUL: reversed. Found: nothing. (with it)"


@pytest.mark.parametrize("begin", [50, 0], ids=["in time", "after the clock was set back"])
def test_the_motion_with_the_payload_is_what_came_after_the_one_without(
    monkeypatch: pytest.MonkeyPatch, begin: int
) -> None:
    looked: list[Any] = []
    monkeypatch.setattr(BackgroundSearch, "start", lambda _, look: looked.append(look.args[1:]))
    recent, search = Recent(100.0), PayloadSearch(lambda _: None)
    worker: Any = SimpleNamespace(session=SimpleNamespace(recent=recent), recent_messages=recent.entries)
    without, loaded = (
        AcceptedMessages(JOINT_STATES, 10**9 * np.arange(first, first + 20), np.zeros((20, 9))) for first in (30, begin)
    )
    recent(without)
    assert search.take_empty(worker)[0]
    assert search.take_loaded(worker) == (False, "no data since the motion without the payload")
    recent(loaded)
    assert search.take_loaded(worker)[0]
    ((empty, full),) = looked
    for messages, expected in ((empty, without), (full, loaded)):
        assert [message.stamps.tolist() for message in messages] == [expected.stamps.tolist()]
