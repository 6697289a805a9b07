"""Bags as arrays that faults can be planted in, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.measured_data import DATA
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINTS = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
_BAGS = Path(__file__).parents[2] / "bags"


@dataclass(frozen=True, kw_only=True)
class Source:
    """A recording that is sound: its bag, its URDF and the parameters it needs."""

    bag: Path
    urdf: Path
    settings: Mapping[str, Any] = field(default_factory=dict)
    wrench: str = ""


SOURCES = {
    "arm7": Source(bag=_BAGS / "arm7", urdf=_BAGS / "arm7.urdf", wrench="/wrench:wrist_ft:mounted"),
    "ur10": Source(
        bag=DATA / "ur10_unisa_rosbag2/ur10_exciting_trajectory", urdf=DATA / "ur10_unisa_rosbag2/ur10.urdf"
    ),
    "rokae": Source(
        bag=DATA / "rokae_ar5_tilted/real",
        urdf=DATA / "rokae_ar5_tilted/AR5-5_07R-W4C4A2.urdf",
        settings={"gravity": [9.88, -0.165, -0.141]},
    ),
    "med7": Source(bag=DATA / "kuka_med7/measurements", urdf=DATA / "kuka_med7/med7.urdf"),
    "lwr4": Source(bag=DATA / "kuka_lwr4_hw/measurements_1", urdf=DATA / "kuka_lwr4_hw/kuka_lwr4.urdf"),
    "airbot": Source(bag=DATA / "airbot_play/chirp", urdf=DATA / "airbot_play/airbot_play.urdf"),
}


CLEAN = {
    **SOURCES,
    "lwr4 2": Source(bag=DATA / "kuka_lwr4_hw/measurements_2", urdf=DATA / "kuka_lwr4_hw/kuka_lwr4.urdf"),
    "airbot loaded": Source(bag=DATA / "airbot_play/chirp_loaded", urdf=DATA / "airbot_play/airbot_play.urdf"),
    "airbot trapez": Source(bag=DATA / "airbot_play/trapez", urdf=DATA / "airbot_play/airbot_play.urdf"),
    **{f"kr300 {run}": Source(bag=DATA / f"kuka_kr300/FF_{run}", urdf=DATA / "kuka_kr300/kr300.urdf") for run in "ABC"},
    "tx40": Source(bag=DATA / "staubli_tx40/tx40", urdf=DATA / "staubli_tx40/tx40.urdf"),
    "go2": Source(bag=DATA / "go2_air/traj_0", urdf=DATA / "go2_air/go2.urdf"),
    "arm3": Source(bag=_BAGS / "arm3", urdf=_BAGS / "arm3.urdf", wrench="/wrench:wrist_ft:mounted"),
}
"""All recordings in which nothing is wrong."""

ARM3 = Source(bag=_BAGS / "arm3", urdf=_BAGS / "arm3.urdf")


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """The messages of a bag.

    Attributes:
        source: where they are from.
        urdf: text of the robot description.
        robot: of the URDF; the joint axis of arrays follows its joints.
        messages: all of them, with their topics, types and times of recording [ns].
        stamps: ``(N,)`` of the joint messages [s].
        position, effort: ``(N, joints)``.
        velocity: ``(N, joints)``; None where the messages have none.
        wrench: ``(M, 6)`` of the wrench messages; their stamps ``wrench_stamps`` ``(M,)`` [s].
        gravity: ``(3,)`` as it is configured.
    """

    source: Source
    urdf: str
    robot: Robot
    messages: list[tuple[str, str, int, Any]]
    stamps: FloatArray
    position: FloatArray
    velocity: FloatArray | None
    effort: FloatArray
    wrench: FloatArray
    wrench_stamps: FloatArray
    gravity: FloatArray

    @staticmethod
    def read(source: Source) -> Recording:
        """Read a bag."""
        urdf = read_urdf(source.urdf)
        robot = Robot(urdf, source=str(source.urdf))
        with Reader(source.bag) as reader:
            messages = [
                (c.topic, c.msgtype, time, TYPES.deserialize_cdr(raw, c.msgtype))
                for c, time, raw in reader.messages()
                if c.msgtype == WRENCH or (c.msgtype == JOINTS and c.topic.endswith("joint_states"))
            ]
        states = [message for _, kind, _, message in messages if kind == JOINTS]
        order = [list(states[0].name).index(joint) for joint in robot.joint_names]
        wrenches = [message for _, kind, _, message in messages if kind == WRENCH]
        return Recording(
            source=source,
            urdf=urdf,
            robot=robot,
            messages=messages,
            stamps=np.array([_seconds(message) for message in states]),
            position=np.array([message.position[order] for message in states]),
            velocity=np.array([message.velocity[order] for message in states]) if len(states[0].velocity) else None,
            effort=np.array([message.effort[order] for message in states]),
            wrench=np.array([_six(message) for message in wrenches]).reshape(-1, 6),
            wrench_stamps=np.array([_seconds(message) for message in wrenches]),
            gravity=np.array(source.settings.get("gravity", (0.0, 0.0, -9.81))),
        )

    def part(self, begin: float, end: float) -> Recording:
        """The messages between two shares of the time, 0 to 1."""
        first, last = self.stamps[0], self.stamps[-1]
        low, high = (first + share * (last - first) for share in (begin, end))
        joints, wrenches = (low <= stamps for stamps in (self.stamps, self.wrench_stamps))
        joints, wrenches = joints & (self.stamps <= high), wrenches & (self.wrench_stamps <= high)
        counts = {JOINTS: iter(joints), WRENCH: iter(wrenches)}
        return replace(
            self,
            messages=[entry for entry in self.messages if next(counts[entry[1]])],
            stamps=self.stamps[joints],
            position=self.position[joints],
            velocity=None if self.velocity is None else self.velocity[joints],
            effort=self.effort[joints],
            wrench=self.wrench[wrenches],
            wrench_stamps=self.wrench_stamps[wrenches],
        )

    def write(self, folder: Path) -> Path:
        """Record into a new bag; returns ``folder``."""
        counts = {JOINTS: 0, WRENCH: 0}
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}
            for topic, kind, time, message in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
                self._put(kind, counts[kind], message)
                counts[kind] += 1
                writer.write(connections[topic], time, bytes(TYPES.serialize_cdr(message, kind)))
        return folder

    def _put(self, kind: str, index: int, message: Any) -> None:
        if kind == WRENCH:
            values = self.wrench[index]
            for part, three in ((message.wrench.force, values[:3]), (message.wrench.torque, values[3:])):
                part.x, part.y, part.z = map(float, three)
            _stamp(message, self.wrench_stamps[index])
            return
        message.name = list(self.robot.joint_names)
        message.position, message.effort = self.position[index].copy(), self.effort[index].copy()
        message.velocity = np.zeros(0) if self.velocity is None else self.velocity[index].copy()
        _stamp(message, self.stamps[index])


def _seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def _stamp(message: Any, seconds: float) -> None:
    nanoseconds = round(seconds * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)


def _six(message: Any) -> list[float]:
    force, torque = message.wrench.force, message.wrench.torque
    return [force.x, force.y, force.z, torque.x, torque.y, torque.z]
