"""Weighs a payload in what a live session remembers: the motion without it, then the one with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from geomid_ros.errors import InputError
from geomid_ros.exports.weighed_payload import Payload, weigh_at
from geomid_ros.live.background_search import BackgroundSearch, SearchStatus
from geomid_ros.live.worker import Worker
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress
from geomid_ros.session.payload import payload_session
from geomid_ros.session.recordings import samples_of_messages
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, Accepted

NO_DATA = "no data yet"


class PayloadSearch:
    """Remembers the motion without the payload, and weighs it when there is one with it."""

    def __init__(self, on_end: Callable[[SearchStatus[Payload]], None]) -> None:
        """``on_end``: see :class:`BackgroundSearch`."""
        self._search = BackgroundSearch("not weighed", on_end)
        self._empty: Sequence[Accepted] = ()

    def forget(self) -> None:
        """Forget the motion without the payload."""
        self._empty = ()

    def close(self) -> None:
        """The same, and end the search without an answer."""
        self.forget()
        self._search.close()

    def take_empty(self, worker: Worker) -> tuple[bool, str]:
        """Remember what the robot did lately as its motion without the payload. Whether that succeeded, and a
        sentence."""
        messages = worker.recent_messages()
        if not messages:
            return False, NO_DATA
        self._empty = messages
        return (
            True,
            f"{_seconds(messages):.0f} s without the payload are stored; mount it, move, and call ~/payload/loaded",
        )

    def take_loaded(self, worker: Worker) -> tuple[bool, str]:
        """Begin to weigh what the robot has carried since then. Whether it can be, and a sentence."""
        if not self._empty:
            return False, "no motion without the payload yet: move the robot without it, and call ~/payload/empty"
        if self._search.running:
            return False, "already running; the result is published on ~/payload"
        begin = _last_stamp(self._empty) + 1
        loaded = [late for each in worker.recent_messages() if len(late := each.since(begin))]
        if not loaded:
            return False, "no data since the motion without the payload"
        live, empty = worker.session, self._empty

        def look(progress: Progress) -> Payload:
            session = payload_session(live.urdf, live.configuration, "robot_description")
            return _weigh(session, empty, loaded, progress)

        self._search.start(look)
        return True, f"identifying the payload from {_seconds(loaded):.0f} s; the result is published on ~/payload"


def _weigh(session: Session, empty: Sequence[Accepted], loaded: Sequence[Accepted], progress: Progress) -> Payload:
    samples: list[Samples] = []
    for what, messages in (("without", empty), ("with", loaded)):
        stage = f"reading the motion {what} the payload"
        found = samples_of_messages(session.new_pipeline(), messages, stage, progress)
        if found is None:
            raise InputError(f"too little motion {what} the payload: move all joints for half a minute")
        session.review.judge_apart()
        session.review.check.add(found)
        session.review.judge()
        samples.append(found)
    progress("solving", 0.0)
    frame, gain = session.configuration["payload.frame"], session.configuration["payload.gain"]
    return weigh_at(session, samples[:1], samples[1:], frame, gain)


def _last_stamp(messages: Sequence[Accepted]) -> int:
    return max(int(each.stamps[-1]) for each in messages)


def _seconds(messages: Sequence[Accepted]) -> float:
    """The time that joint messages span [s]."""
    joints = [each for each in messages if each.topic == JOINT_STATES] or messages
    return 1e-9 * float(_last_stamp(joints) - min(int(each.stamps[0]) for each in joints))
