"""From messages to samples: validation, alignment, filtering, differentiation.

The node and the bag reader feed one message after the other and collect what samples have become ready; both get the
same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.columns import NO_COLUMNS, Columns
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import JOINT_STATES, ODOM, Accepted, Message
from geomid_ros.signals.sampler import Sampler
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.signals.validation import Validator

_DEFAULTS = SignalSettings()
_MOST_BYTES = 100_000_000
_BYTES_BESIDE_NUMBERS = 250  # of a message that is remembered


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
        wrenches = [sensor.topic for sensor in sensors]
        if len({JOINT_STATES, ODOM, *wrenches}) < 2 + len(wrenches):
            raise InputError(
                f"wrench topics must differ from each other, '{JOINT_STATES}' and '{ODOM}': {', '.join(wrenches)}"
            )
        without_end = np.array([joint in continuous for joint in joints], dtype=bool)
        self.ledger = ledger or Ledger()
        self._on_accepted = on_accepted
        self._sampler = Sampler(
            settings,
            without_end,
            wrenches=wrenches,
            floating_base=floating_base,
            effect_columns=effect_columns,
            ledger=self.ledger,
        )
        self._validator = Validator(
            joints,
            sensors,
            settings,
            without_end,
            ledger=self.ledger,
            use=self._use,
            restart=self._sampler.restart,
        )

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._sampler.lag

    @property
    def held(self) -> int:
        """Number of messages that later ones will decide on."""
        return self._validator.held

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose efforts are left out, as they have not been measured for long."""
        return self._validator.unmeasured

    def push(self, message: Message) -> None:
        """Take a message; one that cannot be used is counted.

        Raises:
            InputError: its sensor was not declared, or the cutoff is too high for the rate of the messages.
        """
        self._validator.push(message)

    def _use(self, accepted: Accepted) -> None:
        self._on_accepted(accepted)
        self._sampler.add(accepted)

    def push_accepted(self, accepted: Accepted) -> None:
        """Take what another pipeline for the same robot has accepted, in the same order."""
        self._sampler.add(accepted)
        self.ledger.accept(accepted.topic)

    def release(self) -> None:
        """Reject the messages that are held: no more will come."""
        self._validator.release()

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
