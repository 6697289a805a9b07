"""Recording of a rosbag2 in MCAP, with the topics of a real robot.

Checksums are written here: rosbags omits them, and a flipped bit would change a value unnoticed.
"""

from __future__ import annotations

import struct
import sys
from binascii import crc32
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from geomid_ros.simulation.effect_sizes import WRENCH_TOPIC
from geomid_ros.simulation.motion import RunTrace, WalkTrace
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.types import FloatArray

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

START = 1_700_000_000
"""Stamp of the first message [s]."""

_NANO = 1_000_000_000
_UNSET = QosTime(0, 0)
_DESCRIPTION = "robot_description"
_TYPES = get_typestore(Stores.ROS2_JAZZY)

# MCAP format
_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")  # kind, length
_CHUNK_HEAD = struct.Struct("<QQQII4sQ")  # first and last time, size, checksum, "zstd", packed size


def write_bag(path: Path, trace: RunTrace, names: Sequence[str], urdf: str, options: SimulationOptions) -> None:
    """Write ``/robot_description`` and ``/joint_states`` to a new bag, and ``/wrench`` and ``/joint_commands`` if
    ``options`` request them.

    ``names`` are the trace's joints, in its order, which is also that of the messages. A command is a JointState with
    the set-points' positions and velocities and the controller's feed-forward efforts.
    """
    with _new_bag(path, urdf) as writer:
        states = writer.topic("/joint_states", "sensor_msgs/msg/JointState")
        commands = writer.topic("/joint_commands", "sensor_msgs/msg/JointState") if options.commands else None
        frame = options.wrench_frame
        wrenches = writer.topic(WRENCH_TOPIC, "geometry_msgs/msg/WrenchStamped") if frame else None
        for row, (stamp, wrench_stamp) in enumerate(zip(_stamps(trace.time), _stamps(trace.wrench_time), strict=True)):
            state = trace.position[row], trace.velocity[row], trace.effort[row]
            writer.write_message(states, stamp, _joint_state(stamp, names, *state))
            if commands is not None:
                setpoint = trace.commands.position[row], trace.commands.velocity[row], trace.feedforward[row]
                writer.write_message(commands, stamp, _joint_state(stamp, names, *setpoint))
            if wrenches is not None:
                writer.write_message(wrenches, wrench_stamp, _wrench(trace.wrench[row], wrench_stamp, frame))


def write_walk(path: Path, trace: WalkTrace, names: Sequence[str], urdf: str, imu: str) -> None:
    """Write ``/robot_description``, ``/joint_states`` and ``/imu``, measured at the link ``imu``, to a new bag."""
    with _new_bag(path, urdf) as writer:
        states = writer.topic("/joint_states", "sensor_msgs/msg/JointState")
        imus = writer.topic("/imu", "sensor_msgs/msg/Imu")
        for row, stamp in enumerate(_stamps(trace.time)):
            state = trace.position[row], trace.velocity[row], trace.effort[row]
            writer.write_message(states, stamp, _joint_state(stamp, names, *state))
            message = _imu(trace.angular_velocity[row], trace.specific_force[row], stamp, imu)
            writer.write_message(imus, stamp, message)


@contextmanager
def _new_bag(path: Path, urdf: str) -> Iterator[BagWriter]:
    """Open a new bag that contains a robot's description."""
    with closing(BagWriter(path)) as bag:
        description = bag.topic("/robot_description", "std_msgs/msg/String")
        bag.write_message(description, START * _NANO, _message("std_msgs/msg/String", data=urdf))
        yield bag


class BagWriter:
    """Writer of a new MCAP bag; :meth:`close` adds the checksums."""

    def __init__(self, path: Path) -> None:
        """Raises OSError or WriterError if the bag cannot be written."""
        self._file = path / f"{path.name}.mcap"
        self._writer = Writer(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()

    def topic(self, name: str, kind: str) -> Connection:
        """Add a topic with messages of type ``kind``; a robot description is latched for late subscribers."""
        latched = name.rpartition("/")[2] == _DESCRIPTION
        durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        return self._writer.add_connection(name, kind, typestore=_TYPES, offered_qos_profiles=[_reliable(durability)])

    def write(self, topic: Connection, stamp: int, data: bytes | memoryview) -> None:
        """Write a serialised message at a stamp [ns]."""
        self._writer.write(topic, stamp, data)

    def write_message(self, topic: Connection, stamp: int, message: object) -> None:
        """Write a message at a stamp [ns]."""
        self.write(topic, stamp, _TYPES.serialize_cdr(message, topic.msgtype))

    def close(self) -> None:
        """Close the bag and add the checksums."""
        self._writer.close()
        _add_checksums(self._file)


def _reliable(durability: QosDurability) -> Qos:
    """Recorded quality of service of a reliable publisher."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if durability is QosDurability.TRANSIENT_LOCAL else 10,
        reliability=QosReliability.RELIABLE,
        durability=durability,
        deadline=_UNSET,
        lifespan=_UNSET,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_UNSET,
        avoid_ros_namespace_conventions=False,
    )


def _stamps(time: FloatArray) -> Iterator[int]:
    return (START * _NANO + round(seconds * _NANO) for seconds in time.tolist())


def _message(kind: str, **fields: Any) -> Any:
    return _TYPES.types[kind](**fields)


def _header(stamp: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(stamp, _NANO)
    time = _message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return _message("std_msgs/msg/Header", stamp=time, frame_id=frame)


def _joint_state(
    stamp: int, names: Sequence[str], position: FloatArray, velocity: FloatArray, effort: FloatArray
) -> Any:
    return _message(
        "sensor_msgs/msg/JointState",
        header=_header(stamp, ""),
        name=list(names),
        position=np.ascontiguousarray(position),
        velocity=np.ascontiguousarray(velocity),
        effort=np.ascontiguousarray(effort),
    )


def _vector(values: FloatArray) -> Any:
    x, y, z = values.tolist()
    return _message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _imu(angular_velocity: FloatArray, specific_force: FloatArray, stamp: int, frame: str) -> Any:
    """IMU message without an orientation, which a covariance of -1 indicates."""
    unknown = np.append(-1.0, np.zeros(8))
    return _message(
        "sensor_msgs/msg/Imu",
        header=_header(stamp, frame),
        orientation=_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=_vector(angular_velocity),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(specific_force),
        linear_acceleration_covariance=np.zeros(9),
    )


def _wrench(wrench: FloatArray, stamp: int, frame: str | None) -> Any:
    force, torque = map(_vector, np.split(wrench, 2))
    return _message(
        "geometry_msgs/msg/WrenchStamped",
        header=_header(stamp, frame or ""),
        wrench=_message("geometry_msgs/msg/Wrench", force=force, torque=torque),
    )


def _add_checksums(path: Path) -> None:
    """Write the checksums of chunks, data section and summary into a file with zstd chunks."""
    data = bytearray(path.read_bytes())
    begin, data_end, kind = len(_MAGIC), 0, 0
    while kind != _FOOTER:
        kind, length = _RECORD.unpack_from(data, begin)
        content = begin + _RECORD.size
        if kind == _CHUNK:
            packed = content + _CHUNK_HEAD.size
            struct.pack_into("<I", data, content + 24, crc32(zstd.decompress(data[packed : content + length])))
        elif kind == _DATA_END:
            struct.pack_into("<I", data, content, crc32(data[:begin]))
            data_end = content + length
        elif kind == _FOOTER:
            struct.pack_into("<I", data, content + 16, crc32(data[data_end : content + 16]))
        begin = content + length
    path.write_bytes(data)
