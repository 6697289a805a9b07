"""Background searches of a node, for a gap and for a payload: one at a time, in a thread. The end of the node does not
wait for it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from geomid_ros.checks.causes import RecordingFault
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.exports.payload import Payload, identify_payload_at
from geomid_ros.files.models.estimate_file import causes_entry
from geomid_ros.files.models.gap_file import gap_document
from geomid_ros.gap.result import GapResult
from geomid_ros.live.threads import start_daemon
from geomid_ros.live.worker import Worker
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import samples_of_messages
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages

R = TypeVar("R", bound="FoundGap | Payload")


@dataclass(frozen=True)
class SearchStatus(Generic[R]):
    """State of a search: a ``sentence``; its ``stage`` while it runs, then its ``result``. A failed search has
    neither."""

    sentence: str
    stage: str = ""
    result: R | None = None

    @property
    def document(self) -> dict[str, Any]:
        """Result as a document; only the sentence, as ``error``, if there is no result."""
        return self.result.document if self.result else {"error": self.sentence}


class _EndedError(Exception):
    """The search was closed."""


class BackgroundSearch(Generic[R]):
    """Runs one search at a time in a thread."""

    def __init__(self, failure: str, on_end: Callable[[SearchStatus[R]], None]) -> None:
        """
        Args:
            failure: text before the reason if a search fails.
            on_end: ``on_end(status)`` is called in the search's thread when a search ends by itself.
        """
        self._failure = failure
        self._on_end = on_end
        self.status: SearchStatus[R] | None = None  # of the present or last search
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()  # set to end the present search
        self._lock = threading.Lock()  # held while on_end is called

    @property
    def running(self) -> bool:
        """True if a search is running; a closed search runs until it notices."""
        ending = self._ended.is_set() and self._thread is not None and self._thread.is_alive()
        return ending or (self.status is not None and self.status.stage != "")

    def start(self, look: Callable[[Progress], R]) -> None:
        """Start the search ``look(progress)`` in a thread."""
        self._ended = threading.Event()
        self._progress(self._ended, "beginning", 0.0)
        self._thread = start_daemon("search", self._run, look, self._ended)

    def close(self) -> None:
        """End the present search without calling ``on_end``, and forget the last status."""
        with self._lock:
            self._ended.set()
            self.status = None

    def _run(self, look: Callable[[Progress], R], ended: threading.Event) -> None:
        try:
            result = look(partial(self._progress, ended))
            status = SearchStatus(result.sentence, result=result)
        except _EndedError:
            return
        except InputError as error:
            status = SearchStatus(f"{self._failure}: {error}")
        except Exception as error:  # noqa: BLE001 the caller must have an answer
            status = SearchStatus(f"{self._failure}: {type(error).__name__}: {error}")
        with self._lock:
            if not ended.is_set():
                self.status = status
                self._on_end(status)

    def _progress(self, ended: threading.Event, stage: str, fraction: float) -> None:
        with self._lock:
            if ended.is_set():
                raise _EndedError
            self.status = SearchStatus(f"running: {stage}, {100.0 * fraction:.0f} %", stage)


COMPARED = "compared with the estimate before the gap"


@dataclass(frozen=True)
class FoundGap:
    """Result of a gap search: ``result``, ``causes`` that make it doubtful, ``warnings``, ``notes``, and the reference
    that it is ``compared`` with, if not the robot description."""

    result: GapResult
    causes: Sequence[RecordingFault] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    compared: str = ""

    @property
    def sentence(self) -> str:
        """Verdict in one sentence, after what makes it doubtful."""
        doubts = "".join(f"DOUBTFUL: {cause.sentence}. " for cause in self.causes if cause.sure)
        sentence = doubts + verdict_sentence(self.result)
        return f"{sentence} ({self.compared})" if self.compared else sentence

    @property
    def document(self) -> dict[str, Any]:
        """Document as in ``gap.json``."""
        remarks = {"causes": causes_entry(self.causes), "warnings": [*self.warnings], "notes": [*self.notes]}
        document = gap_document(self.result, {}) | remarks
        return document | ({"compared_with": self.compared} if self.compared else {})


def look_for_gap(
    session: Session,
    before: Estimate | None,
    earlier: Sequence[AcceptedMessages],
    messages: Sequence[AcceptedMessages],
    progress: Progress,
) -> FoundGap:
    """Search for a gap in messages that the pipeline of a live session has accepted.

    Args:
        session: session of the node.
        before: estimate from before a gap opened, as the reference; None for the robot description and the configured
            model.
        earlier: messages that ``before`` is from: a remainder that they had already is no change.
        messages: messages to search in.
        progress: called with the current stage.

    Raises:
        InputError: too little was measured.
    """
    from geomid_ros.session import gap  # noqa: PLC0415 a third of a node's start, and rarely needed

    if before is None:
        ref, compared = gap.gap_session(session.urdf, session.configuration, "robot_description"), ""
        known = gap.known_remainder_of(ref)
    else:
        ref, compared = gap.identified_session(session, before), f"{COMPARED}, of {before.rows_accepted} rows"
        known = gap.remainder_in_messages(ref, earlier, progress)
    result = gap.find_in_messages(ref, messages, known, progress)
    notes = session.notes if compared else [*session.notes, *ref.review.settled]
    return FoundGap(result, ref.review.findings, ref.review.warnings(), notes, compared)


NO_DATA = "no data yet"


class PayloadSearch:
    """Remembers a motion without the payload, and identifies the payload from a motion with it."""

    def __init__(self, on_end: Callable[[SearchStatus[Payload]], None]) -> None:
        """``on_end``: see :class:`BackgroundSearch`."""
        self._search = BackgroundSearch("not weighed", on_end)
        self._empty: Sequence[AcceptedMessages] = ()
        self._count = 0  # entries that the worker had accepted by then

    def forget(self) -> None:
        """Forget the motion without the payload."""
        self._empty = ()

    def close(self) -> None:
        """Forget the motion without the payload, and end the search without an answer."""
        self.forget()
        self._search.close()

    def take_empty(self, worker: Worker) -> tuple[bool, str]:
        """Remember the latest motion as the one without the payload. Return True if that succeeded, and a sentence."""
        messages = worker.recent_messages()
        if not messages:
            return False, NO_DATA
        self._empty, self._count = messages, worker.session.recent.count
        return (
            True,
            f"{_seconds(messages):.0f} s without the payload are stored; mount it, move, and call ~/payload/loaded",
        )

    def take_loaded(self, worker: Worker) -> tuple[bool, str]:
        """Start to identify the payload from the motion since :meth:`take_empty`. Return True if that is possible, and
        a sentence."""
        if not self._empty:
            return False, "no motion without the payload yet: move the robot without it, and call ~/payload/empty"
        if self._search.running:
            return False, "already running; the result is published on ~/payload"
        loaded = worker.recent_messages(self._count)
        if not loaded:
            return False, "no data since the motion without the payload"
        self._search.start(partial(_weigh, worker.session, self._empty, loaded))
        return True, f"identifying the payload from {_seconds(loaded):.0f} s; the result is published on ~/payload"


def _weigh(
    live: Session, empty: Sequence[AcceptedMessages], loaded: Sequence[AcceptedMessages], progress: Progress
) -> Payload:
    session = payload_session(live.urdf, live.configuration, "robot_description")
    recordings: list[Samples] = []
    for condition, messages in (("without", empty), ("with", loaded)):
        stage = f"reading the motion {condition} the payload"
        samples = samples_of_messages(session.new_pipeline(), messages, stage, progress)
        if samples is None:
            raise InputError(f"too little motion {condition} the payload: move all joints for half a minute")
        session.review.check_separately()
        session.review.check.add(samples)
        session.review.judge()
        recordings.append(samples)
    progress("solving", 0.0)
    frame, gain = session.configuration["payload.frame"], session.configuration["payload.gain"]
    return identify_payload_at(session, recordings[:1], recordings[1:], frame, gain)


def _seconds(messages: Sequence[AcceptedMessages]) -> float:
    """Time span of joint messages [s]."""
    joints = [block for block in messages if block.topic == JOINT_STATES] or messages
    return 1e-9 * float(max(block.stamps[-1] for block in joints) - min(block.stamps[0] for block in joints))
