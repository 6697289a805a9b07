"""From messages to samples: decides which messages are used, in each topic's order of stamps; a sampler does the rest.

The bag reader pushes large blocks of messages, the node small ones, often of one message. Both collect the samples that
are ready, and get the same samples, with a fixed lag behind the data (:attr:`SignalPipeline.lag`).
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import repeat

import numpy as np

from geomid_ros.errors import InputError, check_name
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.samples import Column, Samples
from geomid_ros.signals.gates import Gate, JointGate, ReorderBuffer, Source
from geomid_ros.signals.joint_messages import SILENT, JointReader, JointStateMerger, LockedJoints, Part
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.message_batch import NO_STAMP, NOT_VALID, MessageBatch, commands, imu_readings, poses, wrenches
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, AcceptedMessages, Block, Message
from geomid_ros.signals.moving_base import Stance
from geomid_ros.signals.sampler import Sampler
from geomid_ros.signals.settings import MOST_WAITING, SignalSettings
from geomid_ros.types import AnyArray, FloatArray

UNDECIDED = "end of data: too few later messages to validate them"


def ignore(*_: object) -> None:
    """Do nothing."""


class SignalPipeline:
    """Takes messages with :meth:`push`; :meth:`collect` returns the samples that they complete."""

    def __init__(
        self,
        model: MeasurementModel,
        settings: SignalSettings,
        *,
        effect_columns: tuple[Column, ...] | None = None,
        on_accepted: Callable[[AcceptedMessages], None] = ignore,
        ledger: Ledger | None = None,
        received_joints: set[str] | None = None,
        locked_joints: Collection[str] = (),
        still_distance: float = 0.0,
        mount: ImuMount | None = None,
        controller: PDController | None = None,
    ) -> None:
        """
        Args:
            model: the robot and its sensors. The pose of a floating base comes on ODOM, unless it has an IMU. Positions
                of joints without limits may jump by whole turns between messages, and are wrapped to -pi to pi in
                samples; in those of other revolute joints a step of a whole turn is caused by the driver, and is
                undone.
            settings: settings of the filter and of efforts.
            effect_columns: columns of effects that samples contain; those of the model unless given.
            on_accepted: called with all accepted messages, in the form that :meth:`push_accepted` takes.
            ledger: counts all messages.
            received_joints: set to which the names of joints in messages are added.
            locked_joints: joints that count as fixed at zero; remarks tell if messages contradict that.
            still_distance: distance between two of their positions that differ [rad, m].
            mount: pose of the IMU on a floating base; its messages come on IMU.
            controller: controller of the joints: efforts are computed from commands, which come on COMMANDS.

        Raises:
            InputError: two topics have the same name, a gain is of an unknown joint, or the cutoff is too high.
        """
        robot = model.robot
        self._joints = robot.joint_names
        self._sensors = {sensor.topic: sensor for sensor in model.sensors}
        reserved = JOINT_STATES, ODOM, IMU, COMMANDS
        if len({*reserved, *self._sensors}) < len(reserved) + len(model.sensors):
            named = ", ".join(sensor.topic for sensor in model.sensors)
            raise InputError(f"wrench topics must differ from each other and from {', '.join(reserved)}: {named}")
        self._max_gap = settings.max_gap_ns
        self._gains = settings.effort_gains(self._joints)
        self._continuous = np.array([joint.continuous for joint in robot.joints], dtype=bool)
        self._turning = np.array([joint.unit == "N m" for joint in robot.joints], dtype=bool)
        self._limits = np.array([robot.speed_limits, robot.effort_limits])
        self.ledger = ledger or Ledger()
        self.received_joints = set() if received_joints is None else received_joints
        self._on_accepted, self._commanded = on_accepted, controller is not None
        resolved = round(0.5e9 / settings.cutoff)
        note = partial(self.ledger.note, JOINT_STATES)
        self._locked = LockedJoints(locked_joints, still_distance, note)
        self._parts = JointStateMerger(self._joints, self._max_gap, resolved, self._new_reader, note, settings.merge)
        self._admission = ReorderBuffer(self._new_gate, self.ledger.note)
        self._arrived = 0  # number of messages
        self._open: Counter[str] = Counter()  # messages that are not yet accounted for
        self._joined: list[tuple[int, Part, int, FloatArray]] = []  # messages to merge with those of other joints
        self._sampler = Sampler(model, settings, effect_columns or model.columns, self.ledger, mount, controller)
        self._stance = Stance(model.legs.loads, settings.cutoff) if model.legs is not None else None

    def _new_reader(self, joints: Part) -> JointReader:
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
    def period(self) -> float:
        """Period of the time grid [s]; 0 until the rate is known."""
        return self._sampler.period

    @property
    def lag(self) -> float:
        """Time [s] by which samples trail the newest message; 0 until the rate is known."""
        return self._sampler.lag

    @property
    def waiting_count(self) -> int:
        """Number of messages that wait for later ones to decide."""
        return sum(list(self._open.values()))

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Joints whose efforts are left out, as they have not been measured for long."""
        return () if self._commanded else self._parts.unmeasured

    @property
    def silent(self) -> tuple[str, ...]:
        """Joints of publishers that have fallen silent, if joint messages are merged."""
        return self._parts.silent

    def push(self, messages: Message | Sequence[Block]) -> None:
        """Take messages; unusable ones are counted. If this fails, the unprocessed ones are dropped and counted, except
        those that wait for a decision.

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

    def _take(self, batch: Mapping[Source, MessageBatch]) -> None:
        """Admit new messages and use the released ones."""
        for index, admitted in enumerate(self._admission.take(batch, self._arrived - 1)):
            if index:
                self._begin_anew()
            for source, arrived in admitted.items():
                self._use(source, arrived)
        self._join_parts()
        self._sampler.make_samples()

    @contextmanager
    def _dropping(self) -> Iterator[None]:
        """If the code inside fails, drop and count unprocessed messages, except those that wait for a decision."""
        try:
            yield
        except Exception as error:
            self._joined.clear()
            held = self._admission.waiting_counts
            for topic, count in (self._open - held).items():
                self.ledger.drop(topic, f"{type(error).__name__} while taking a message", count)
            self._open = held
            raise

    def _refused(self, topic: str, reason: str, count: int) -> None:
        self.ledger.reject(topic, reason, count)
        self._open[topic] -= count

    def _read(self, blocks: Iterable[Block]) -> dict[Source, MessageBatch]:
        """Read the messages, each by itself, grouped by source."""
        groups: dict[Source, list[MessageBatch]] = {}
        for block in blocks:
            if block.topic == JOINT_STATES:
                self._locked.watch(block)
                if len(self.received_joints) < MOST_WAITING:
                    self.received_joints.update(block.names)
            part = self._parts.part(block.names) if block.topic == JOINT_STATES else ()
            if isinstance(part, str):
                self._refused(block.topic, part, len(block.stamps))
                continue
            source = block.topic, part
            numbers, refusals = self._numbers(source, block)
            refusals[block.stamps < 0] = NOT_VALID
            refusals[block.stamps == 0] = NO_STAMP
            groups.setdefault(source, []).append(
                MessageBatch(block.order + self._arrived, block.stamps, numbers, refusals)
            )
        return {source: MessageBatch.in_order(arrivals) for source, arrivals in groups.items()}

    def _numbers(self, source: Source, block: Block) -> tuple[FloatArray, AnyArray]:
        if block.topic == JOINT_STATES:
            return self._parts.readers[source[1]].numbers(block)
        if block.topic == COMMANDS:
            return commands(block, self._joints)
        if block.topic == ODOM:
            return poses(block)
        if block.topic == IMU:
            return imu_readings(block)
        check_name("wrench topic", block.topic, self._sensors)
        return wrenches(block, self._sensors[block.topic])

    def _use(self, source: Source, arrived: MessageBatch) -> None:
        """Use the messages that neither their gate nor their reader refuses."""
        topic, part = source
        good = arrived.is_usable
        used, reasons = arrived.select(good), Counter[str](arrived.refusals[~good].tolist())
        if topic == JOINT_STATES and len(used):
            read = MessageBatch(used.order, used.stamps, *self._parts.readers[part].read(used.stamps, used.numbers))
            used = read.select(read.is_usable)
            reasons.update(read.refusals[~read.is_usable].tolist())
        for reason, count in reasons.items():
            self._refused(topic, reason, count)
        if not len(used):
            return
        if topic == JOINT_STATES and self._parts.merges:
            self._joined += zip(used.order.tolist(), repeat(part), used.stamps.tolist(), used.numbers)
        else:
            self._accept(AcceptedMessages(topic, used.stamps, used.numbers))
        self.ledger.accept(topic, len(used))
        self._open[topic] -= len(used)

    def _join_parts(self) -> None:
        """Join the messages of several publishers, in their order of arrival."""
        rows = sorted(self._joined, key=operator.itemgetter(0))
        self._joined.clear()
        joined = [complete for _, part, stamp, row in rows for complete in self._parts.add(part, stamp, row)]
        if joined:
            self._accept(AcceptedMessages(JOINT_STATES, *map(np.array, zip(*joined, strict=True))))

    def _accept(self, accepted: AcceptedMessages) -> None:
        self._on_accepted(accepted)
        self._sampler.add(accepted)

    def push_accepted(self, accepted: AcceptedMessages) -> None:
        """Take messages that another pipeline for the same robot accepted, in the same order."""
        self._sampler.add(accepted)
        self.ledger.accept(accepted.topic, len(accepted))
        self._sampler.make_samples()

    def release(self) -> None:
        """Drop the undecided messages, as no more will come, and use those that waited behind them.

        Raises InputError as :meth:`push` does.
        """
        for topic, count in self._admission.give_up().items():
            if count:
                self.ledger.drop(topic, UNDECIDED, count)
                self._open[topic] -= count
        with self._dropping():
            self._take({})

    def _begin_anew(self) -> None:
        """Begin a new segment, as a clock was set or positions leapt."""
        self._join_parts()
        self._parts.restart()
        self._sampler.restart()

    def collect(self) -> Samples | None:
        """Return the samples that became ready since the last call, oldest first; None if there are none."""
        samples = self._sampler.collect()
        return samples if samples is None or self._stance is None else self._stance.with_stance(samples)
