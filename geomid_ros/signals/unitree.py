"""Messages of Unitree's robots instead of ROS's: LowState as JointState and Imu, LowCmd as set-points.

They are read by byte offsets, as all their fields have fixed sizes: their package is not needed. They have no stamp, so
the time of arrival is used, and no names, so those of the motors are used
(https://github.com/unitreerobotics/unitree_ros2: ``unitree_go/msg`` of quadrupeds, ``unitree_hg/msg`` of humanoids).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.controller import PDController
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, LITTLE_ENDIAN, Raw
from geomid_ros.types import FloatArray

LOW_STATE, LOW_CMD = "unitree_go/msg/LowState", "unitree_go/msg/LowCmd"
HUMANOID_STATE, HUMANOID_CMD = "unitree_hg/msg/LowState", "unitree_hg/msg/LowCmd"
STATES = LOW_STATE, HUMANOID_STATE
KINDS = {JOINT_STATES: STATES, IMU: STATES, COMMANDS: (LOW_CMD, HUMANOID_CMD)}
"""Types that replace the ROS type of each topic."""


@dataclass(frozen=True)
class _Layout:
    """Bytes of a message, with the four of its encapsulation.

    Attributes:
        size: bytes of the message.
        motors: number of motors.
        first: offset of the first motor's position.
        stride: bytes from one motor to the next.
        offsets: of a motor's numbers, in single precision, from its position on: q, dq, tau_est of a state; q, dq,
            tau, kp, kd of a command.
        sensed: offset of the gyroscope's three numbers, which the accelerometer's follow; 0 for a command.
    """

    size: int
    motors: int
    first: int
    stride: int
    offsets: tuple[int, ...]
    sensed: int = 0

    def numbers(self, data: bytes, motors: int) -> FloatArray:
        """Numbers ``(3 or 5, motors)`` of the first motors."""
        first = [self.first + offset for offset in self.offsets]
        return np.array([np.ndarray(motors, "<f4", data, place, self.stride) for place in first], float)


_LAYOUTS = {
    LOW_STATE: _Layout(1180, 20, 84, 48, (0, 4, 12), sensed=44),
    LOW_CMD: _Layout(812, 20, 28, 36, (0, 4, 8, 12, 16)),
    HUMANOID_STATE: _Layout(2092, 35, 76, 56, (0, 4, 12), sensed=36),
    HUMANOID_CMD: _Layout(1004, 35, 8, 28, (0, 4, 8, 12, 16)),
}


@dataclass(eq=False)
class UnitreeMessages:
    """Converts messages (CDR) of Unitree's robots, in their order of arrival.

    Attributes:
        motors: joints of the robot's motors, in their order.
        joints: all joints of the robot.
        controller: its gains, with which set-points are read; None if they are not read.
        source: origin of the motors, for messages.
    """

    motors: Sequence[str]
    joints: Sequence[str]
    controller: PDController | None
    source: str
    _state: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))

    @cached_property
    def _misnamed(self) -> list[str]:
        """Joints that are not once among the motors."""
        return [joint for joint in self.joints if self.motors.count(joint) != 1]

    @cached_property
    def _gains(self) -> FloatArray:
        """Gains kp and kd ``(2, motors)``, NaN where there are none."""
        gains = np.full((2, len(self.motors)), np.nan)
        if self.controller is not None:
            gains[:, [self.motors.index(joint) for joint in self.joints]] = self.controller.kp, self.controller.kd
        return gains

    def read(
        self,
        messages: Sequence[tuple[str, int, str, bytes]],
        names: Mapping[str, Sequence[str]],
        refuse: Callable[[int, str], None],
    ) -> tuple[list[int], list[Raw]]:
        """Convert Unitree's messages, and pass on others. Return each result's place of origin, and the results.

        Args:
            messages: topic, time [ns], type and bytes.
            names: names in the pipeline that are read of each topic.
            refuse: ``refuse(place, why)`` receives messages that are not of their type.
        """
        origins, raw = list[int](), list[Raw]()
        for place, (topic, time, kind, data) in enumerate(messages):
            converted = dict.fromkeys(names[topic], data)
            if kind in _LAYOUTS:
                try:
                    converted = self.translated(kind, time, data)
                except (ValueError, struct.error) as error:  # the time does not fit a stamp
                    refuse(place, str(error))
            named = [(name, converted[name]) for name in names[topic] if name in converted]
            origins += [place] * len(named)
            raw += named
        return origins, raw

    def translated(self, kind: str, time: int, data: bytes) -> dict[str, bytes]:
        """Convert a message of a ``kind`` that arrived at a ``time`` [ns]. Return the resulting messages by topic.

        Raises:
            ValueError: it is not of this kind.
            InputError: there are too many motors, or a joint is not once among them.
        """
        layout = _LAYOUTS[kind]
        if self._misnamed or len(self.motors) > layout.motors:
            raise InputError(
                f"{self.source}: motors: expected up to {layout.motors} joints in the order of {kind}, with "
                f"'{(self._misnamed or self.joints)[0]}' once among them, as in config/quadruped.yaml and "
                f"config/humanoid.yaml; there are: {', '.join(self.motors) or 'none'}"
            )
        if len(data) < layout.size or data[:2] != LITTLE_ENDIAN:
            raise ValueError(f"{len(data)} bytes, expected {layout.size}, little-endian")
        numbers = layout.numbers(data, len(self.motors))
        if not layout.sensed:
            return {COMMANDS: self._joint_state(time, self._set_points(*numbers))} if self._state.size else {}
        self._state = numbers
        sensed = np.frombuffer(data, "<f4", 6, layout.sensed).astype(float)
        return {JOINT_STATES: self._joint_state(time, numbers), IMU: _imu(time, sensed)}

    def _set_points(
        self, target: FloatArray, speed: FloatArray, forward: FloatArray, kp: FloatArray, kd: FloatArray
    ) -> FloatArray:
        """Position, velocity and feed-forward ``(3, motors)`` that are equivalent under the known gains. If a command
        has other gains, return the motors' last state and the effort of the command there."""
        position, velocity, _ = self._state
        effort = kp * (target - position) + kd * (speed - velocity) + forward
        same = np.all(np.isclose([kp, kd], self._gains), axis=0)
        return np.where(same, [target, speed, forward], [position, velocity, effort])

    def _joint_state(self, time: int, numbers: FloatArray) -> bytes:
        """Return a sensor_msgs/JointState of position, velocity and effort ``(3, motors)``."""
        data = _header(time) + struct.pack("<I", len(self.motors))
        for name in self.motors:
            text = name.encode() + b"\0"
            data = _padded(data, 4) + struct.pack("<I", len(text)) + text
        for values in numbers:
            data = _padded(_padded(data, 4) + struct.pack("<I", len(values)), 8) + values.astype("<f8").tobytes()
        return data


def _imu(time: int, sensed: FloatArray) -> bytes:
    """Return a sensor_msgs/Imu of angular velocity and specific force ``(6,)``, without orientation (covariance -1)."""
    parts = ([0.0, 0.0, 0.0, 1.0, -1.0], np.zeros(8), sensed[:3], np.zeros(9), sensed[3:], np.zeros(9))
    return _padded(_header(time), 8) + np.concatenate(parts).astype("<f8").tobytes()


def _header(time: int) -> bytes:
    """Return a std_msgs/Header without a frame, aligned for a count."""
    return _padded(LITTLE_ENDIAN + b"\0\0" + struct.pack("<IIIx", *divmod(time, 1_000_000_000), 1), 4)


def _padded(data: bytes, size: int) -> bytes:
    """Pad with zeros to the next place of a number of this size; the first four bytes do not count."""
    return data + bytes((4 - len(data)) % size)
