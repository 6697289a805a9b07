"""Which messages are used: those whose stamps continue their topic's time and whose numbers are plausible."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import unknown_name
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.joint_messages import JointParts, JointReader, Part, RejectedError, plausible
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import JOINT_STATES, Accepted, JointMessage, Message, PoseMessage, WrenchMessage
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import BoolArray, FloatArray

_TO_CONFIRM_SLOWNESS = 3  # messages, each after a pause
_TO_CONFIRM_A_RESET = 10  # messages; a few late ones do not mean that a clock was set back

_Source: TypeAlias = tuple[str, Part]
"""A topic, and if joint messages are merged, the joints of a publisher."""


class Turn(Enum):
    """How a topic's time goes on."""

    CONTINUED = ""
    PAUSE = "pause: a new segment begins"
    RESET = "clock set back: a new segment begins"


@dataclass
class Judged:
    """The messages that are decided on: those to use, in order, and for each of the others the reason why not."""

    use: list[Message] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    turn: Turn = Turn.CONTINUED


class Timeline:
    """Judges the stamps of one topic.

    A message that is ahead or behind by more than ``max_gap`` [ns] is held until the next ones show what it was. If
    they go on from there it was a pause (one message shows it) or a clock that was set back; if they do not, a wrong
    stamp. On a topic slower than ``max_gap`` no message goes on from the one before: two more show the pause.
    """

    def __init__(self, max_gap: int) -> None:
        self._max_gap = max_gap
        self._last = 0
        self._held: list[Message] = []

    @property
    def held(self) -> int:
        """Number of messages that are held."""
        return len(self._held)

    def judge(self, message: Message) -> Judged:
        """Take a message, and decide on it and on those that are held, as far as possible."""
        stamp = message.stamp
        if stamp <= 0:
            return Judged(refused=["stamp is zero" if stamp == 0 else "stamp is not valid"])
        ahead = stamp - self._last
        if self._last and not -self._max_gap <= ahead <= self._max_gap:
            return self._hold(message)
        judged = Judged(refused=self.release())
        if ahead > 0:
            judged.use.append(message)
        else:
            judged.refused.append("stamp not later than the one before")
        return judged

    def _hold(self, message: Message) -> Judged:
        judged, stamp = Judged(), message.stamp
        back = stamp < self._last
        if self._held and self._held[-1].stamp - self._max_gap <= stamp <= self._held[-1].stamp:
            return Judged(refused=["stamp not later than the one before"])
        while self._held and (stamp < self._held[-1].stamp or back != (self._held[-1].stamp < self._last)):
            judged.refused.append(self._reason(self._held.pop()))
        self._held.append(message)
        if self._is_confirmed(back):
            judged.turn = Turn.RESET if back else Turn.PAUSE
            judged.use, self._held = self._held, []
            if back:
                self._last = 0
        return judged

    def _is_confirmed(self, back: bool) -> bool:
        if back:
            return len(self._held) >= _TO_CONFIRM_A_RESET
        stamps = [message.stamp for message in self._held]
        return len(stamps) >= _TO_CONFIRM_SLOWNESS or (len(stamps) > 1 and stamps[1] - stamps[0] <= self._max_gap)

    def advance(self, stamp: int) -> None:
        """Note that a message with this stamp is used."""
        self._last = stamp

    def release(self) -> list[str]:
        """Refuse the messages that are held. Returns the reason for each."""
        reasons = [self._reason(message) for message in self._held]
        self._held.clear()
        return reasons

    def _reason(self, message: Message) -> str:
        return "stamp from the future" if message.stamp > self._last else "stamp too old"

    def forget(self) -> list[Message]:
        """Begin anew. Returns the messages that were held, to begin with."""
        held, self._held, self._last = self._held, [], 0
        return held


class Validator:
    """Passes on the messages that can be used, in the order of each topic's stamps, and counts the others."""

    def __init__(
        self,
        joints: Sequence[str],
        sensors: Sequence[WrenchSensor],
        settings: SignalSettings,
        continuous: BoolArray,
        *,
        ledger: Ledger,
        use: Callable[[Accepted], None],
        restart: Callable[[], None],
    ) -> None:
        """
        Args:
            joints: the robot's.
            sensors: those whose topics are read.
            settings: what an effort number means, which pauses are long, and whether joint messages are merged.
            continuous: ``(joints,)`` the joints without end.
            ledger: is told what becomes of every message.
            use: takes what is accepted. What it raises, :meth:`push` raises.
            restart: is called when a clock was set back, before anything of the new time is used.
        """
        self._joints = tuple(joints)
        self._sensors = {sensor.topic: sensor for sensor in sensors}
        self._gains = settings.effort_gains(self._joints)
        self._continuous = continuous
        self._max_gap = settings.max_gap_ns
        self._ledger = ledger
        self._use_accepted = use
        self._restart_use = restart
        self._reader = self._new_reader(self._joints)
        self._parts = JointParts(self._joints, self._max_gap, self._new_reader) if settings.merge else None
        self._timelines: dict[_Source, Timeline] = {}

    def _new_reader(self, joints: Sequence[str]) -> JointReader:
        places = [self._joints.index(joint) for joint in joints]
        note = partial(self._ledger.note, JOINT_STATES)
        return JointReader(joints, self._gains[places], self._continuous[places], self._max_gap, note)

    @property
    def held(self) -> int:
        """Number of messages that later ones will decide on."""
        return sum(timeline.held for timeline in list(self._timelines.values()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose efforts are left out, as they have not been measured for long."""
        readers = self._parts.readers.values() if self._parts else (self._reader,)
        return tuple(joint for reader in readers for joint in reader.unmeasured)

    def push(self, message: Message) -> None:
        """Take a message. Raises InputError for a wrench of a sensor that was not declared."""
        if isinstance(message, WrenchMessage) and message.topic not in self._sensors:
            raise unknown_name("wrench topic", message.topic, self._sensors)
        try:
            source = message.topic, self._part(message)
        except RejectedError as error:
            self._ledger.reject(message.topic, str(error))
            return
        if source not in self._timelines:
            self._timelines[source] = Timeline(self._max_gap)
        judged = self._timelines[source].judge(message)
        for reason in judged.refused:
            self._ledger.reject(message.topic, reason)
        if judged.turn is not Turn.CONTINUED:
            self._ledger.note(message.topic, judged.turn.value)
        if judged.turn is Turn.RESET:
            self._restart(source)
        self._use_all(source, judged.use)

    def _part(self, message: Message) -> Part:
        return self._parts.part(message.names) if self._parts and isinstance(message, JointMessage) else ()

    def _use_all(self, source: _Source, messages: Iterable[Message]) -> None:
        todo = deque(messages)
        try:
            while todo:
                self._use(source, todo.popleft())
        except Exception as error:  # the caller counts the message that caused it
            for _ in todo:
                self._ledger.drop(source[0], f"{type(error).__name__} while another message was taken")
            raise

    def _use(self, source: _Source, message: Message) -> None:
        topic, part = source
        try:
            values = self._numbers(part, message)
        except RejectedError as error:
            self._ledger.reject(topic, str(error))
            return
        self._timelines[source].advance(message.stamp)
        if self._parts and part:
            for stamp, whole in self._parts.add(part, message.stamp, values):
                self._use_accepted(Accepted(topic, stamp, whole))
        else:
            self._use_accepted(Accepted(topic, message.stamp, values))
        self._ledger.accept(topic)

    def _numbers(self, part: Part, message: Message) -> FloatArray:
        """The checked numbers of a message. Raises RejectedError if they cannot be used."""
        if isinstance(message, JointMessage):
            return (self._parts.readers[part] if self._parts else self._reader).read(message)
        if isinstance(message, PoseMessage):
            return _pose(message)
        return _wrench(message, self._sensors[message.topic])

    def release(self) -> None:
        """Reject the messages that are held: no more will come."""
        for (topic, _), timeline in self._timelines.items():
            for reason in timeline.release():
                self._ledger.reject(topic, reason)

    def _restart(self, source: _Source) -> None:
        """Begin anew everywhere, as the clock of ``source`` was set back."""
        self._reader.restart()
        if self._parts:
            self._parts.restart()
        self._restart_use()
        for other, timeline in self._timelines.items():
            if other != source:
                for held in timeline.forget():
                    self._use(other, held)


def _pose(message: PoseMessage) -> FloatArray:
    if not np.all(plausible(message.pose)):
        raise RejectedError("pose not finite")
    norm = float(np.linalg.norm(message.pose[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise RejectedError("quaternion is not of length 1")
    values = message.pose.copy()
    values[3:] /= norm
    return values


def _wrench(message: WrenchMessage, sensor: WrenchSensor) -> FloatArray:
    declared = sensor.frame_id or sensor.frame
    if message.frame and message.frame != declared:
        raise RejectedError(f"frame '{message.frame}' is not the declared '{declared}'")
    if not np.all(plausible(message.wrench[sensor.axis_indices])):
        raise RejectedError("wrench not finite")
    return message.wrench - sensor.sign * np.array(sensor.offset)
