"""From messages to samples: which messages are used, in the order of each topic's stamps; a sampler does the rest.

The bag reader feeds large blocks of messages, the node small ones, often of one message, and both collect what samples
have become ready. They get the same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import repeat

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.columns import Column
from geomid_ros.model.controller import Controller
from geomid_ros.model.imu import ImuMount
from geomid_ros.model.samples import Samples
from geomid_ros.signals.admission import Admission, Gate, Source
from geomid_ros.signals.arrived import (
    NO_STAMP,
    NOT_VALID,
    Arrived,
    commands,
    inertial,
    poses,
    without_refusal,
    wrenches,
)
from geomid_ros.signals.joint_gate import JointGate
from geomid_ros.signals.joint_messages import JointReader, RejectedError
from geomid_ros.signals.joint_parts import SILENT, JointParts, Part
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, Accepted, Block, Message
from geomid_ros.signals.moving_base import Stance
from geomid_ros.signals.sampler import Sampler
from geomid_ros.signals.settings import MOST_WAITING, SignalSettings
from geomid_ros.types import AnyArray, FloatArray

_DEFAULTS = SignalSettings()

UNDECIDED = "came last, when too few followed to tell whether they are right"


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
        turning: Sequence[str] = (),
        limits: FloatArray | None = None,
        effect_columns: tuple[Column, ...] = (),
        on_accepted: Callable[[Accepted], None] = ignore,
        ledger: Ledger | None = None,
        joints_heard: set[str] | None = None,
        mount: ImuMount | None = None,
        loads: Callable[[Samples], FloatArray] | None = None,
        controller: Controller | None = None,
    ) -> None:
        """
        Args:
            joints: the robot's, in its order.
            floating_base: whether the base moves: its pose comes on ODOM, unless it has an IMU.
            sensors: the wrench sensors, in the order of samples.
            settings: of the filter and of efforts.
            continuous: the joints without end: their positions may jump by whole turns between messages, and are given
                from -pi to pi in samples.
            turning: the revolute joints: a step of a whole turn in their positions is the driver's, and is undone.
            limits: ``(2, joints)`` the URDF's of speeds and of efforts, infinite where it has none.
            effect_columns: those that samples carry (:attr:`MeasurementModel.columns`).
            on_accepted: is told of every message that is accepted, as :meth:`push_accepted` takes it.
            ledger: is told what becomes of every message.
            joints_heard: the names of joints in messages are added to it.
            mount: of the IMU on a floating base, whose messages come on IMU.
            controller: of the joints: efforts are those of commands, which come on COMMANDS.
            loads: of the feet, whose stance samples carry; see :class:`~geomid_ros.signals.moving_base.Stance`.

        Raises:
            InputError: two topics have the same name, a gain is of an unknown joint, or the cutoff is too high.
        """
        self._joints = tuple(joints)
        self._sensors = {sensor.topic: sensor for sensor in sensors}
        reserved = JOINT_STATES, ODOM, IMU, COMMANDS
        if len({*reserved, *self._sensors}) < len(reserved) + len(sensors):
            named = ", ".join(sensor.topic for sensor in sensors)
            raise InputError(f"wrench topics must differ from each other and from {', '.join(reserved)}: {named}")
        self._max_gap = settings.max_gap_ns
        self._gains = settings.effort_gains(self._joints)
        self._continuous = np.array([joint in continuous for joint in self._joints], dtype=bool)
        self._turning = np.array([joint in turning for joint in self._joints], dtype=bool)
        self._limits = np.full((2, len(self._joints)), np.inf) if limits is None else limits
        self.ledger = ledger or Ledger()
        self.joints_heard = set() if joints_heard is None else joints_heard
        self._on_accepted, self._commanded = on_accepted, controller is not None
        resolved = round(0.5e9 / settings.cutoff)
        note = partial(self.ledger.note, JOINT_STATES)
        self._parts = JointParts(self._joints, self._max_gap, resolved, self._new_reader, note, settings.merge)
        self._admission = Admission(self._new_gate, self.ledger.note)
        self._arrived = 0  # messages
        self._open: Counter[str] = Counter()  # messages of which nothing has become yet
        self._joined: list[tuple[int, Part, int, FloatArray]] = []  # messages that wait for the other parts
        base = [ODOM if mount is None else IMU] if floating_base else []
        topics = (*self._sensors, *base)
        self._sampler = Sampler(
            settings, self._continuous, topics, effect_columns, self.ledger, mount=mount, controller=controller
        )
        self._stance = Stance(loads, settings.cutoff) if loads is not None else None

    def _new_reader(self, joints: Sequence[str]) -> JointReader:
        places = [self._joints.index(joint) for joint in joints]
        note = partial(self.ledger.note, JOINT_STATES)
        return JointReader(
            joints, self._gains[places], self._continuous[places], self._max_gap, note, self._turning[places]
        )

    def _new_gate(self, source: Source) -> Gate:
        topic, joints = source
        if topic != JOINT_STATES:
            return Gate(self._max_gap)
        places = [self._joints.index(joint) for joint in joints]
        turning = self._turning[places] | self._continuous[places]
        max_gap = max(self._max_gap, SILENT) if self._parts.merges else self._max_gap
        return JointGate(joints, self._limits[:, places], turning, max_gap)

    @property
    def lag(self) -> float:
        """Seconds by which samples trail the newest message; 0 until the rate is known."""
        return self._sampler.lag

    @property
    def held(self) -> int:
        """Number of messages that later ones will decide on."""
        return sum(list(self._open.values()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The joints whose efforts are left out, as they have not been measured for long."""
        return () if self._commanded else self._parts.unmeasured

    @property
    def silent(self) -> tuple[str, ...]:
        """The joints of publishers that have fallen silent, if joint messages are merged."""
        return self._parts.silent

    def push(self, messages: Message | Sequence[Block]) -> None:
        """Take a message, or many; those that cannot be used are counted. If this fails, all that are left are dropped
        and counted.

        Raises:
            InputError: a sensor was not declared, or the cutoff is too high for the rate of the messages.
        """
        blocks = messages if isinstance(messages, Sequence) else [Block.of(messages)]
        for block in blocks:
            self._open[block.topic] += len(block.stamps)
        with self._dropping():
            batch = self._read(blocks)
            self._arrived += sum(len(block.stamps) for block in blocks)
            self._take(batch)

    def _take(self, batch: Mapping[Source, Arrived]) -> None:
        """Use what is admitted when messages have come."""
        for part, admitted in enumerate(self._admission.take(batch, self._arrived - 1)):
            if part:
                self._begin_anew()
            for source, arrived in admitted.items():
                self._use(source, arrived)
        self._join_parts()
        self._sampler.make_samples()

    @contextmanager
    def _dropping(self) -> Iterator[None]:
        """If what is done inside fails, messages of which nothing has become are dropped and counted."""
        try:
            yield
        except Exception as error:
            self._joined.clear()
            held = self._admission.held
            for topic, count in (self._open - held).items():
                self.ledger.drop(topic, f"{type(error).__name__} while taking a message", count)
            self._open = held
            raise

    def _refused(self, topic: str, reason: str, count: int) -> None:
        self.ledger.reject(topic, reason, count)
        self._open[topic] -= count

    def _read(self, blocks: Iterable[Block]) -> dict[Source, Arrived]:
        """What messages say by themselves, by their source."""
        found: dict[Source, list[Arrived]] = {}
        for block in blocks:
            if block.topic == JOINT_STATES and len(self.joints_heard) < MOST_WAITING:
                self.joints_heard.update(block.names)
            try:
                source = block.topic, self._part(block)
            except RejectedError as error:
                self._refused(block.topic, error.reason, len(block.stamps))
                continue
            numbers, refusals = self._numbers(source, block)
            refusals[block.stamps < 0] = NOT_VALID
            refusals[block.stamps == 0] = NO_STAMP
            found.setdefault(source, []).append(Arrived(block.order + self._arrived, block.stamps, numbers, refusals))
        return {source: Arrived.in_order(several) for source, several in found.items()}

    def _part(self, block: Block) -> Part:
        return self._parts.part(block.names) if block.topic == JOINT_STATES else ()

    def _numbers(self, source: Source, block: Block) -> tuple[FloatArray, AnyArray]:
        if block.topic == JOINT_STATES:
            return self._parts.readers[source[1]].numbers(block)
        if block.topic == COMMANDS:
            return commands(block, self._joints)
        if block.topic == ODOM:
            return poses(block)
        if block.topic == IMU:
            return inertial(block)
        if block.topic not in self._sensors:
            raise unknown_name("wrench topic", block.topic, self._sensors)
        return wrenches(block, self._sensors[block.topic])

    def _use(self, source: Source, arrived: Arrived) -> None:
        """Use the messages that are not refused, by their gate or their reader."""
        topic, part = source
        good, refused = arrived.good, list[str]()
        if not good.all():
            refused += arrived.refusals[~good].tolist()
            arrived = arrived.select(good)
        stamps, values, order = arrived.stamps, arrived.numbers, arrived.order
        if topic == JOINT_STATES and len(stamps):
            values, refusals = self._parts.readers[part].read(stamps, values)
            taken = without_refusal(refusals)
            if not taken.all():
                refused += refusals[~taken].tolist()
                stamps, values, order = stamps[taken], values[taken], order[taken]
        for reason, count in Counter(refused).items():
            self._refused(topic, reason, count)
        if len(stamps):
            if topic == JOINT_STATES and self._parts.merges:
                self._joined += zip(order.tolist(), repeat(part), stamps.tolist(), values)
            else:
                self._accept(Accepted(topic, stamps, values))
            self.ledger.accept(topic, len(stamps))
            self._open[topic] -= len(stamps)

    def _join_parts(self) -> None:
        """Join the messages of several publishers, in the order in which they came."""
        rows = sorted(self._joined, key=operator.itemgetter(0))
        self._joined.clear()
        found = [whole for _, part, stamp, row in rows for whole in self._parts.add(part, stamp, row)]
        if found:
            self._accept(Accepted(JOINT_STATES, *map(np.array, zip(*found, strict=True))))

    def _accept(self, accepted: Accepted) -> None:
        self._on_accepted(accepted)
        self._sampler.add(accepted)

    def push_accepted(self, accepted: Accepted) -> None:
        """Take what another pipeline for the same robot has accepted, in the same order."""
        self._sampler.add(accepted)
        self.ledger.accept(accepted.topic, len(accepted))
        self._sampler.make_samples()

    def release(self) -> None:
        """Give up the messages that nothing has decided on, as no more will come; what waited behind them is used.

        Raises InputError as :meth:`push` does.
        """
        for topic, count in self._admission.give_up().items():
            if count:
                self.ledger.drop(topic, UNDECIDED, count)
                self._open[topic] -= count
        with self._dropping():
            self._take({})

    def _begin_anew(self) -> None:
        """Begin a new segment, as a clock was set."""
        self._join_parts()
        self._parts.restart()
        self._sampler.restart()

    def collect(self) -> Samples | None:
        """The samples that have become ready since the last call, oldest first; None if there are none."""
        samples = self._sampler.collect()
        return samples if samples is None or self._stance is None else self._stance.known(samples)
