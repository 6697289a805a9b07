"""From messages to samples: which messages are used, in the order of each topic's stamps; a sampler does the rest.

The node and the bag reader feed one message after the other and collect what samples have become ready; both get the
same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.columns import NO_COLUMNS, Columns
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.joint_messages import JointParts, JointReader, Part, RejectedError, plausible
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import JOINT_STATES, ODOM, Accepted, JointMessage, Message, PoseMessage, WrenchMessage
from geomid_ros.signals.sampler import Sampler
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.timeline import Timeline, Turn
from geomid_ros.types import FloatArray

_DEFAULTS = SignalSettings()
_MOST_BYTES = 100_000_000
_BYTES_BESIDE_NUMBERS = 250  # of a message that is remembered

_Source: TypeAlias = tuple[str, Part]
"""A topic, and if joint messages are merged, the joints of a publisher."""


def ignore(*_: object) -> None:
    """Do nothing."""


class SignalPipeline:
    """Takes messages with :meth:`push`; :meth:`collect` gives the samples that they complete."""

    def __init__(
        self,
        joints: Sequence[str],
        *,
        floating_base: bool = False,
        sensors: Sequence[WrenchSensor] = (),
        settings: SignalSettings = _DEFAULTS,
        continuous: Sequence[str] = (),
        effect_columns: Columns = NO_COLUMNS,
        on_accepted: Callable[[Accepted], None] = ignore,
        ledger: Ledger | None = None,
    ) -> None:
        """
        Args:
            joints: the robot's, in its order.
            floating_base: whether the base's pose comes on ODOM.
            sensors: the wrench sensors, in the order of samples.
            settings: of the filter and of efforts.
            continuous: the joints without end: their positions may jump by whole turns between messages, and are given
                from -pi to pi in samples.
            effect_columns: those that samples carry (:attr:`MeasurementModel.columns`).
            on_accepted: is told of every message that is accepted, as :meth:`push_accepted` takes it.
            ledger: is told what becomes of every message.

        Raises:
            InputError: two topics have the same name, a gain is of an unknown joint, or the cutoff is too high.
        """
        self._joints = tuple(joints)
        self._sensors = {sensor.topic: sensor for sensor in sensors}
        if len({JOINT_STATES, ODOM, *self._sensors}) < 2 + len(sensors):
            named = ", ".join(sensor.topic for sensor in sensors)
            raise InputError(f"wrench topics must differ from each other, '{JOINT_STATES}' and '{ODOM}': {named}")
        self._max_gap = settings.max_gap_ns
        self._gains = settings.effort_gains(self._joints)
        self._continuous = np.array([joint in continuous for joint in self._joints], dtype=bool)
        self.ledger = ledger or Ledger()
        self._on_accepted = on_accepted
        self._reader = self._new_reader(self._joints)
        self._parts = JointParts(self._joints, self._max_gap, self._new_reader) if settings.merge else None
        self._timelines: dict[_Source, Timeline] = {}
        topics = (*self._sensors, ODOM) if floating_base else tuple(self._sensors)
        self._sampler = Sampler(settings, self._continuous, topics, effect_columns, self.ledger)

    def _new_reader(self, joints: Sequence[str]) -> JointReader:
        places = [self._joints.index(joint) for joint in joints]
        note = partial(self.ledger.note, JOINT_STATES)
        return JointReader(joints, self._gains[places], self._continuous[places], self._max_gap, note)

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._sampler.lag

    @property
    def held(self) -> int:
        """Number of messages that later ones will decide on."""
        return sum(timeline.held for timeline in list(self._timelines.values()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose efforts are left out, as they have not been measured for long."""
        readers = self._parts.readers.values() if self._parts else (self._reader,)
        return tuple(joint for reader in readers for joint in reader.unmeasured)

    @property
    def silent(self) -> tuple[str, ...]:
        """The joints of publishers that have fallen silent, if joint messages are merged."""
        return self._parts.silent if self._parts else ()

    def push(self, message: Message) -> None:
        """Take a message; one that cannot be used is counted.

        Raises:
            InputError: its sensor was not declared, or the cutoff is too high for the rate of the messages.
        """
        if isinstance(message, WrenchMessage) and message.topic not in self._sensors:
            raise unknown_name("wrench topic", message.topic, self._sensors)
        try:
            source = message.topic, self._part(message)
        except RejectedError as error:
            self.ledger.reject(message.topic, str(error))
            return
        if source not in self._timelines:
            self._timelines[source] = Timeline(self._max_gap)
        judged = self._timelines[source].judge(message)
        for reason in judged.refused:
            self.ledger.reject(message.topic, reason)
        if judged.turn is not Turn.CONTINUED:
            self.ledger.note(message.topic, judged.turn.value)
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
                self.ledger.drop(source[0], f"{type(error).__name__} while another message was taken")
            raise

    def _use(self, source: _Source, message: Message) -> None:
        topic, part = source
        try:
            values = self._numbers(part, message)
        except RejectedError as error:
            self.ledger.reject(topic, str(error))
            return
        self._timelines[source].advance(message.stamp)
        if self._parts and part:
            for stamp, whole in self._parts.add(part, message.stamp, values):
                self._accept(Accepted(topic, stamp, whole))
        else:
            self._accept(Accepted(topic, message.stamp, values))
        self.ledger.accept(topic)

    def _numbers(self, part: Part, message: Message) -> FloatArray:
        """The checked numbers of a message. Raises RejectedError if they cannot be used."""
        if isinstance(message, JointMessage):
            return (self._parts.readers[part] if self._parts else self._reader).read(message)
        if isinstance(message, PoseMessage):
            return _pose(message)
        return _wrench(message, self._sensors[message.topic])

    def _accept(self, accepted: Accepted) -> None:
        self._on_accepted(accepted)
        self._sampler.add(accepted)

    def push_accepted(self, accepted: Accepted) -> None:
        """Take what another pipeline for the same robot has accepted, in the same order."""
        self._sampler.add(accepted)
        self.ledger.accept(accepted.topic)

    def release(self) -> None:
        """Reject the messages that are held: no more will come."""
        for (topic, _), timeline in self._timelines.items():
            for reason in timeline.release():
                self.ledger.reject(topic, reason)

    def _restart(self, source: _Source) -> None:
        """Begin anew everywhere, as the clock of ``source`` was set back."""
        self._reader.restart()
        if self._parts:
            self._parts.restart()
        self._sampler.restart()
        for other, timeline in self._timelines.items():
            if other != source:
                for held in timeline.forget():
                    self._use(other, held)

    def collect(self) -> Samples | None:
        """The samples that have become ready since the last call, oldest first; None if there are none."""
        return self._sampler.collect()


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
        """Keep the numbers of a message."""
        topic, stamp = accepted.topic, accepted.stamp
        with self._lock:
            if stamp <= self._last.get(topic, 0):  # the clock was set back
                self.clear()
            self._last[topic] = stamp
            self._entries.append(accepted)
            self._bytes += _size(accepted)
            while self._entries and (self._bytes > _MOST_BYTES or self._entries[0].stamp <= stamp - self._nanoseconds):
                self._bytes -= _size(self._entries.popleft())

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


def _size(accepted: Accepted) -> int:
    return accepted.values.nbytes + _BYTES_BESIDE_NUMBERS


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
