"""Messages with named numbers, as tests spoil them; the pipeline takes them for what is parsed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, TypeAlias

import numpy as np

from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM
from geomid_ros.types import FloatArray


class _Sent:
    """What :class:`~geomid_ros.signals.messages.Message` says, by the fields of a dataclass."""

    def __post_init__(self) -> None:
        for name in self._numbers():
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))

    def _numbers(self) -> list[str]:
        return [field.name for field in fields(self) if field.type == "FloatArray"]

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        return tuple(getattr(self, name) for name in self._numbers())


@dataclass(frozen=True, eq=False)
class JointMessage(_Sent):
    topic: ClassVar[str] = JOINT_STATES
    stamp: int
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


class CommandMessage(JointMessage):
    topic: ClassVar[str] = COMMANDS


@dataclass(frozen=True, eq=False)
class PoseMessage(_Sent):
    topic: ClassVar[str] = ODOM
    names: ClassVar[tuple[str, ...]] = ()
    stamp: int
    pose: FloatArray


@dataclass(frozen=True, eq=False)
class WrenchMessage(_Sent):
    topic: str
    stamp: int
    frame: str
    wrench: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        return (self.frame,)


@dataclass(frozen=True, eq=False)
class ImuMessage(_Sent):
    topic: ClassVar[str] = IMU
    names: ClassVar[tuple[str, ...]] = ()
    stamp: int
    numbers: FloatArray


Message: TypeAlias = JointMessage | PoseMessage | WrenchMessage | ImuMessage
