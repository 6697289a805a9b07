"""Unitree's messages as rosbags writes them, by their definitions."""

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from geomid_ros.signals.unitree import LOW_CMD, LOW_STATE
from geomid_ros.types import FloatArray

_IMU = "float32[4] quaternion\nfloat32[3] gyroscope\nfloat32[3] accelerometer\nfloat32[3] rpy\n"
_STATE = "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
_CMD = "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n"
_HEAD = "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\nuint32[2] sn\nuint32[2] version\nuint16 bandwidth\n"
_MODES = "uint8 mode_pr\nuint8 mode_machine\n"
_DEFINITIONS = {
    "unitree_go": {
        "IMUState": f"{_IMU}int8 temperature\n",
        "MotorState": f"{_STATE}float32 q_raw\nfloat32 dq_raw\nfloat32 ddq_raw\nint8 temperature\nuint32 lost\n"
        "uint32[2] reserve\n",
        "MotorCmd": f"{_CMD}uint32[3] reserve\n",
        "BmsState": "uint8 version_high\nuint8 version_low\nuint8 status\nuint8 soc\nint32 current\nuint16 cycle\n"
        "int8[2] bq_ntc\nint8[2] mcu_ntc\nuint16[15] cell_vol\n",
        "BmsCmd": "uint8 off\nuint8[3] reserve\n",
        "LowState": f"{_HEAD}IMUState imu_state\nMotorState[20] motor_state\nBmsState bms_state\n"
        "int16[4] foot_force\nint16[4] foot_force_est\nuint32 tick\nuint8[40] wireless_remote\nuint8 bit_flag\n"
        "float32 adc_reel\nint8 temperature_ntc1\nint8 temperature_ntc2\nfloat32 power_v\nfloat32 power_a\n"
        "uint16[4] fan_frequency\nuint32 reserve\nuint32 crc\n",
        "LowCmd": f"{_HEAD}MotorCmd[20] motor_cmd\nBmsCmd bms_cmd\nuint8[40] wireless_remote\nuint8[12] led\n"
        "uint8[2] fan\nuint8 gpio\nuint32 reserve\nuint32 crc\n",
    },
    "unitree_hg": {
        "IMUState": f"{_IMU}int16 temperature\n",
        "MotorState": f"{_STATE}int16[2] temperature\nfloat32 vol\nuint32[2] sensor\nuint32 motorstate\n"
        "uint32[4] reserve\n",
        "MotorCmd": f"{_CMD}uint32 reserve\n",
        "LowState": f"uint32[2] version\n{_MODES}uint32 tick\nIMUState imu_state\nMotorState[35] motor_state\n"
        "uint8[40] wireless_remote\nuint32[4] reserve\nuint32 crc\n",
        "LowCmd": f"{_MODES}MotorCmd[35] motor_cmd\nuint32[4] reserve\nuint32 crc\n",
    },
}
_MOTORS = {"unitree_go": 20, "unitree_hg": 35}


@cache
def types() -> Any:
    """A store of types with Unitree's."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, Any] = {}
    for package, definitions in _DEFINITIONS.items():
        for name, text in definitions.items():
            found |= get_types_from_msg(text, f"{package}/msg/{name}")
    store.register(found)
    return store


def _filled(kind: str, **fields: Any) -> Any:
    """A message of which all other fields are ones."""
    found = {}
    for name, (node, detail) in types().fielddefs[kind][1]:
        if name in fields:
            found[name] = fields[name]
        elif node.name == "BASE":
            found[name] = 1
        elif node.name == "NAME":
            found[name] = _filled(detail)
        else:
            (inner, of), count = detail
            own = of[0] if inner.name == "BASE" else of
            found[name] = np.ones(count, own) if inner.name == "BASE" else [_filled(own) for _ in range(count)]
    return types().types[kind](**found)


def low_state(
    motors: Sequence[FloatArray], gyroscope: FloatArray, accelerometer: FloatArray, package: str = "unitree_go"
) -> bytes:
    """With ``motors`` of which each has position, velocity and effort; all others are at one."""
    kind = f"{package}/msg/MotorState"
    states = [_filled(kind, q=q, dq=dq, tau_est=tau) for q, dq, tau in motors]
    states += [_filled(kind)] * (_MOTORS[package] - len(states))
    numbers = {"gyroscope": gyroscope, "accelerometer": accelerometer}
    imu = _filled(f"{package}/msg/IMUState", **{name: own.astype("f4") for name, own in numbers.items()})
    kind = f"{package}/msg/LowState"
    return bytes(types().serialize_cdr(_filled(kind, motor_state=states, imu_state=imu), kind))


def low_cmd(motors: Sequence[FloatArray], package: str = "unitree_go") -> bytes:
    """With ``motors`` of which each has position, velocity, effort, kp and kd."""
    names, kind = ("q", "dq", "tau", "kp", "kd"), f"{package}/msg/MotorCmd"
    commands = [_filled(kind, **dict(zip(names, own, strict=True))) for own in motors]
    commands += [_filled(kind)] * (_MOTORS[package] - len(commands))
    kind = f"{package}/msg/LowCmd"
    return bytes(types().serialize_cdr(_filled(kind, motor_cmd=commands), kind))


def write_unitree_bag(path: Path, messages: Iterable[tuple[str, int, bytes]]) -> Path:
    """Write a bag of LowState on ``/lowstate`` and LowCmd on ``/lowcmd``: topics, times [ns] and bytes."""
    with Writer(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {"/lowstate": LOW_STATE, "/lowcmd": LOW_CMD}
        connections = {topic: writer.add_connection(topic, kind, typestore=types()) for topic, kind in kinds.items()}
        for topic, time, data in messages:
            writer.write(connections[topic], time, data)
    return path
