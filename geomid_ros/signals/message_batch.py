"""Messages on arrival: their numbers in the robot's order, and which are unusable by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.messages import Block
from geomid_ros.signals.settings import LARGEST_NUMBER, UNLIKE_ONE
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

NO_STAMP = "stamp is zero: whoever publishes has to fill in header.stamp"
NOT_VALID = "stamp is not valid"
_NOT_MEASURED = -1.0  # first entry of a covariance; see sensor_msgs/Imu


def plausible(values: FloatArray) -> BoolArray:
    """False for NaN, infinity and numbers that no robot measures."""
    return np.abs(values) < LARGEST_NUMBER


@dataclass(frozen=True, eq=False, slots=True)
class MessageBatch:
    """N messages of one source: arrival indices ``order``, stamps [ns], and numbers in the robot's order.

    ``refusals`` are the reasons why messages are unusable by themselves, None for usable ones.
    """

    order: IntArray
    stamps: IntArray
    numbers: FloatArray
    refusals: AnyArray

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def is_usable(self) -> BoolArray:
        """True for messages that are usable by themselves ``(N,)``."""
        return without_refusal(self.refusals)

    def select(self, index: BoolArray | IntArray | slice) -> MessageBatch:
        """Return a selection of the messages."""
        return MessageBatch(self.order[index], self.stamps[index], self.numbers[index], self.refusals[index])

    def split(self, place: int) -> tuple[MessageBatch, MessageBatch]:
        """Split into messages before arrival index ``place``, and the others."""
        return self.split_after(int(np.searchsorted(self.order, place)))

    def split_after(self, count: int) -> tuple[MessageBatch, MessageBatch]:
        """Split into the first ``count`` messages, and the others."""
        if count >= len(self):
            return self, NO_MESSAGES
        return self.select(slice(count)), self.select(slice(count, None))

    @staticmethod
    def joined(several: Sequence[MessageBatch]) -> MessageBatch:
        """Concatenate messages."""
        nonempty = [part for part in several if len(part)]
        if len(nonempty) < 2:
            return (nonempty or several)[0]
        columns = zip(*((e.order, e.stamps, e.numbers, e.refusals) for e in nonempty), strict=True)
        return MessageBatch(*(np.concatenate(column) for column in columns))

    @staticmethod
    def in_order(several: Sequence[MessageBatch]) -> MessageBatch:
        """Concatenate messages, and sort them by arrival."""
        merged = MessageBatch.joined(several)
        return merged.select(np.argsort(merged.order, kind="stable")) if len(several) > 1 else merged


NO_MESSAGES = MessageBatch(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 0)), np.full(0, None))
"""No messages."""


def without_refusal(refusals: AnyArray) -> BoolArray:
    """True where ``refusals`` are None."""
    usable: BoolArray = refusals == None  # noqa: E711 by element
    return usable


def poses(block: Block) -> tuple[FloatArray, AnyArray]:
    """Poses ``(N, 7)`` with unit quaternions, and the reasons why some are unusable."""
    values, refusals = block.arrays[0].copy(), np.full(len(block.stamps), None)
    invalid = ~plausible(values).all(axis=1)
    values[invalid] = np.nan
    norms = np.linalg.norm(values[:, 3:], axis=1)
    refusals[np.abs(norms - 1.0) > UNLIKE_ONE] = "quaternion is not of length 1"
    refusals[invalid] = "pose not finite"
    good = without_refusal(refusals)
    values[good, 3:] /= norms[good, None]
    return values, refusals


def commands(block: Block, joints: Sequence[str]) -> tuple[FloatArray, AnyArray]:
    """Set-points of positions and velocities and the feed-forward of ``joints``, concatenated ``(N, 3 joints)``, zero
    where a message has none; and the reasons why some are unusable."""
    count, names = len(block.stamps), list(block.names)
    values, refusals = np.zeros((count, 3, len(joints))), np.full(count, None)
    if missing := missing_joint(joints, names):
        refusals[:] = missing
        return values.reshape(count, -1), refusals
    order = [names.index(joint) for joint in joints]
    for kind, numbers in enumerate(block.arrays):
        if numbers.shape[1] == len(names):
            values[:, kind] = numbers[:, order]
        elif numbers.shape[1] or not kind:
            refusals[:] = driver_error(f"a command of {numbers.shape[1]} numbers for {len(names)} names")
    refusals[~plausible(values).all(axis=(1, 2))] = "command not finite"
    return values.reshape(count, -1), refusals


def wrenches(block: Block, sensor: WrenchSensor) -> tuple[FloatArray, AnyArray]:
    """Wrenches ``(N, 6)`` without the sensor's offset, and the reasons why some are unusable."""
    (values,), (frame,), declared = block.arrays, block.names, sensor.frame_id or sensor.frame
    refusals = np.full(len(values), None)
    refusals[~plausible(values[:, sensor.axis_indices]).all(axis=1)] = "wrench not finite"
    if frame and frame != declared:
        refusals[:] = Reason(f"frame '{frame}' is not the declared '{declared}'", "frame")
    return values - sensor.sign * np.array(sensor.offset), refusals


def imu_readings(block: Block) -> tuple[FloatArray, AnyArray]:
    """Angular velocities and specific forces of an IMU ``(N, 6)``, and the reasons why some are unusable."""
    numbers, refusals = block.arrays[0], np.full(len(block.stamps), None)
    values = numbers[:, [13, 14, 15, 25, 26, 27]]
    refusals[~plausible(values).all(axis=1)] = "angular velocity or acceleration not finite"
    refusals[np.any(numbers[:, [16, 28]] == _NOT_MEASURED, axis=1)] = (
        "no angular velocity or no acceleration is measured"
    )
    return values, refusals


MISSING_JOINT_ADVICE = (
    "if nobody publishes it, name it in the parameter locked_joints (--lock); if another node does, set "
    "merge_joint_states (--merge)"
)
"""Advice for a joint that is missing in messages."""


def missing_joint(joints: Sequence[str], names: Sequence[str]) -> str:
    """Return a sentence on why messages with these names do not have all joints; empty if they do.

    Args:
        joints: joints of the robot.
        names: joint names in the messages.
    """
    present = set(names)
    missing = next((joint for joint in joints if joint not in present), None)
    if missing is None:
        return ""
    return Reason(f"joint '{missing}' is missing{_advice(joints, names)}", "joint")


def _advice(joints: Sequence[str], names: Sequence[str]) -> str:
    if prefix := _prefix(joints, names):
        return f": the messages' names have the prefix '{prefix}'. Give the URDF with it (tf_prefix)"
    if prefix := _prefix(names, joints):
        return f": the URDF's names have the prefix '{prefix}', the messages' do not. Give the URDF without it"
    if set(names).isdisjoint(joints):
        quoted = ", ".join(f"'{name}'" for name in names[:3])
        return f": none of the messages' names is a joint of this URDF ({quoted} ...)"
    unknown = next((name for name in names if name not in joints), None)
    other = f"; or is it '{unknown}'?" if unknown else ""
    return f": {MISSING_JOINT_ADVICE}{other}"


def _prefix(plain: Sequence[str], prefixed: Sequence[str]) -> str:
    """Return the common prefix with which all ``plain`` names are among the ``prefixed``; empty if there is none."""
    first = plain[0] if plain else ""
    candidates = (name.removesuffix(first) for name in prefixed if first and name.endswith(first))
    names = set(prefixed)
    return next((prefix for prefix in candidates if prefix and all(prefix + name in names for name in plain)), "")
