"""Predicts efforts for every joint message on arrival: without batches and regressors, with a causal filter."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.dynamics import InverseDynamics, motor_parameters
from geomid_ros.monitoring.payload_watch import CarriedPayload, with_payload
from geomid_ros.session.session import Session
from geomid_ros.signals.joint_messages import JointReader
from geomid_ros.signals.ledger import count_reason
from geomid_ros.signals.message_batch import NO_STAMP
from geomid_ros.signals.messages import COMMANDS, JOINT_STATES, Decoder
from geomid_ros.signals.pipeline import ignore
from geomid_ros.signals.settings import SAMPLES_PER_CUTOFF_PERIOD
from geomid_ros.types import FloatArray, IntArray

_PART = "messages with only some joints (merge_joint_states) do not determine efforts"


@dataclass(frozen=True, eq=False)
class Predicted:
    """Predictions for N messages of ``joints``: ``stamps (N,)`` [ns], ``motion (3, N, joints)``, and the model's
    ``efforts (N, joints)`` in the unit of the messages."""

    joints: tuple[str, ...]
    stamps: IntArray
    motion: FloatArray
    efforts: FloatArray


class EffortPredictor:
    """Predicts efforts with the latest estimate and payload: of joint states what sensors measure, of commands what
    motors need. One thread calls :meth:`set_model` and :meth:`set_payload`, another everything else.

    Accelerations are differences of velocities; those of joint states pass a first-order low-pass at half the rate of
    the samples.
    """

    def __init__(self, topic: str = JOINT_STATES) -> None:
        """``topic`` of the messages: JOINT_STATES or COMMANDS."""
        self._topic = topic
        self._decoder = Decoder()
        self._model: _Model | None = None
        self._used: tuple[Session, Estimate] | None = None
        self._carried: CarriedPayload | None = None
        self._last = (0, np.zeros((3, 0)))  # stamp and motion of the last message
        self.refused: Counter[str] = Counter()
        """Messages that could not be predicted, by reason."""
        self.obstacle = ""
        """Reason why no message can be predicted although there is an estimate."""

    @property
    def ready(self) -> bool:
        """True if there is an estimate that yields efforts."""
        return self._model is not None

    def set_model(self, session: Session, estimate: Estimate) -> None:
        """Predict with an ``estimate`` from now on."""
        self._used = session, estimate
        self.obstacle = _obstacle(session)
        self._model = None if self.obstacle else self._new_model(session, with_payload(estimate, self._carried))

    def _new_model(self, session: Session, estimate: Estimate) -> _Model:
        parameters, drive_gains = estimate.predictor
        bandwidth = np.pi * SAMPLES_PER_CUTOFF_PERIOD * session.signals.cutoff
        if self._topic == COMMANDS:  # they have no noise
            parameters, bandwidth = motor_parameters(session.model, parameters), np.inf
        return _Model(session, InverseDynamics(session.model.with_drive_gains(drive_gains), parameters), bandwidth)

    def set_payload(self, carried: CarriedPayload | None) -> None:
        """Predict with this payload from now on, or with none."""
        self._carried = carried
        if self._used is not None:
            self.set_model(*self._used)

    def forget(self) -> None:
        """Predict nothing until the next estimate."""
        self._model = self._used = self._carried = None
        self.obstacle = ""
        self.refused.clear()

    def predict(self, messages: Sequence[bytes]) -> Iterator[Predicted]:
        """Yield predictions for joint messages (CDR), except for those that cannot be used."""
        model = self._model
        if model is None or not messages:
            return
        for block in self._decoder.blocks([(self._topic, data) for data in messages], ignore):
            numbers, refusals = model.reader.numbers(block)
            good = (refusals == None) & (block.stamps > 0)  # noqa: E711 by element
            stamps = block.stamps
            if not good.all():
                is_part = model.merges and not {*model.joints} <= {*block.names}
                for reason in refusals[~good].tolist():
                    count_reason(self.refused, _PART if is_part else reason or NO_STAMP)
                stamps, numbers = stamps[good], numbers[good]
            if len(stamps):
                motion = self._motion(model, stamps, numbers)
                yield Predicted(model.joints, stamps, motion, model.dynamics(motion) / model.gains)

    def _motion(self, model: _Model, stamps: IntArray, numbers: FloatArray) -> FloatArray:
        """Positions, velocities and accelerations ``(3, N, joints)`` of messages."""
        latest, last = self._last
        if last.shape[1] != numbers.shape[2]:
            latest, last = -model.memory, np.zeros((3, numbers.shape[2]))
        place, before, steps, new = 0, list[int](), list[float](), list[bool]()
        for following, stamp in enumerate(stamps.tolist(), 1):
            step = stamp - latest
            before.append(place)
            steps.append(1e-9 * step if 0 < step < model.memory else math.inf)
            new.append(not -model.memory < step <= 0)
            if new[-1]:
                place, latest = following, stamp
        motion = np.concatenate([last[:, None], np.moveaxis(numbers, 1, 0)], axis=1)
        position, velocity, acceleration = motion
        seconds, is_new, unknown = np.array(steps)[:, None], np.array(new)[:, None], np.isnan(velocity[1:])
        if unknown.any():
            moved = position[1:] - position[before]
            turned = np.remainder(moved + np.pi, 2.0 * np.pi) - np.pi
            velocity[1:][unknown] = (np.where(model.turning, turned, moved) / seconds)[unknown]
            velocity[1:] = np.where(unknown & ~is_new, velocity[before], velocity[1:])
        # Repeated messages, and those out of order, have no information on accelerations.
        gains = np.where(is_new, -np.expm1(-seconds * model.bandwidth), 0.0)
        rates = (velocity[1:] - velocity[before]) / seconds
        for following, (earlier, gain, rate) in enumerate(zip(before, gains, rates, strict=True), 1):
            acceleration[following] = acceleration[earlier] + gain * (rate - acceleration[earlier])
        self._last = latest, motion[:, place].copy()
        return motion[:, 1:]


def _obstacle(session: Session) -> str:
    """Return why efforts do not follow from joint messages alone; empty if they do."""
    if not session.model.layout.efforts:
        return "no joint efforts are identified"
    if session.robot.floating_base:
        return "efforts depend on the motion of the base, which joint states do not contain"
    if session.model.external:
        return "efforts depend on external wrenches, which joint states do not contain"
    return ""


class _Model:
    """Data of a session, and of its estimate: inverse ``dynamics``, ``gains (joints,)`` of efforts, ``turning`` joints
    without limits, the low-pass's ``bandwidth`` [1/s] and its ``memory`` [ns], after which it is reset; ``merges`` if
    each message has only some joints."""

    def __init__(self, session: Session, dynamics: InverseDynamics, bandwidth: float) -> None:
        robot, settings = session.robot, session.signals
        self.joints, self.dynamics = robot.joint_names, dynamics
        self.gains = session.effort_gains
        self.turning = np.array([joint.continuous for joint in robot.joints])
        self.memory = settings.max_gap_ns
        self.reader = JointReader(self.joints, self.gains, self.turning, self.memory, ignore)
        self.merges: bool = session.configuration["merge_joint_states"]
        self.bandwidth = bandwidth
