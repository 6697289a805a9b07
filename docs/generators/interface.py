"""Topics and services that the node opens, read off the node itself, with what they mean."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from geomid_ros.ros.node import GeomidNode

_NAMESPACE, _NAME = "/namespace", "geomid"
# With these the node opens all that it ever opens: simulated time, a wrench sensor, a floating base in two ways.
_ARGUMENTS = ["--ros-args", "-r", f"__ns:={_NAMESPACE}", "-p", "use_sim_time:=true"]
_BASES = (["-p", "floating_base:=true"], ["-p", "imu.frame:=LINK", "-p", "command.gains:=['20:1']"])
_SENSOR = ["-p", "wrenches:=['NAME']", "-p", "wrench.NAME.frame:=LINK"]

_MEANINGS = {
    "joint_states": "joints in any order; they move by their positions, velocities tell wrong stamps and units",
    "robot_description": "the URDF, unless it is given as a parameter",
    "odom": "pose of a floating base, with `floating_base`",
    "joint_commands": "set-points of joints whose efforts are not measured, with `command.gains`; also while "
    "`~/streamed_joint_commands` has a subscriber",
    "imu": "angular velocity and acceleration of a floating base, with `imu.frame`",
    "NAME": "one for every sensor in `wrenches`, here `NAME`; `wrench.NAME.topic` sets another topic",
    "~/inertias": "one message per link; `frame_id` is the link, `com` in its frame, "
    "the inertia about the centre of mass in the link's axes; all zeros for a link that is no longer identified",
    "~/robot_description": "the identified URDF; only with a subscriber",
    "~/estimate": "the last estimate as `estimate.json`, with the identified URDF as `robot_description`; only with a "
    "subscriber",
    "~/predicted_joint_states": "predicted efforts, filtered motion, stamped as the data; only with a subscriber",
    "~/streamed_joint_states": "predicted efforts of every message, milliseconds after it, and its motion; only with a "
    "subscriber",
    "~/streamed_joint_commands": "feed-forward efforts of every message on `joint_commands`, milliseconds after it, by "
    "the last usable estimate; only with a subscriber",
    "~/predicted_efforts_std": "standard deviations of the predicted efforts, from the joint posterior; only with a "
    "subscriber",
    "~/markers": "ellipsoids for RViz, blue: from the prior, orange: from the data",
    "~/gap": "findings of `~/find_gap`, as `gap.json`, with `compared_with` while a gap is open; "
    "only `error` if it failed",
    "~/gap/open": "channels in which a gap is open, when one opens or closes: `channel`, `times_floor`, and the stamp "
    "`since` in ns",
    "~/payload": "result of `~/payload/loaded`, as printed by `geomid payload --json`; only `error` if it failed",
    "~/payload/inertia": "payload that was picked up, in the frame of the link `frame_id`; all zeros after it was put "
    "down",
    "/diagnostics": "at 1 Hz: the stream and every link, see below; the stream status warns if a gap opens",
    "~/start": "start using data",
    "~/stop": "stop using data; rows and estimate are kept",
    "~/reset": "discard all rows, and use the latest robot description",
    "~/save": "solve with all data so far, and write `estimate.json`, `identified.urdf` and `posterior.npz` into "
    "`output_folder`",
    "~/find_gap": "look for a gap in the last `gap.memory` seconds, in the background; result on `~/gap` and in "
    "the diagnostics",
    "~/payload/empty": "store the last `gap.memory` seconds as the motion without a payload",
    "~/payload/loaded": "identify the payload since then; result on `~/payload`",
}


@dataclass(frozen=True)
class Entry:
    """A topic or service under its relative name, as one may remap it."""

    name: str
    kind: str
    qos: str
    meaning: str


@dataclass(frozen=True)
class Interface:
    """All that the node opens; ``of_every_node`` is what any node of rclpy opens."""

    inputs: list[Entry]
    outputs: list[Entry]
    services: list[Entry]
    of_every_node: list[Entry]


def of_the_node() -> Interface:
    """The interface of the node. Raises KeyError for what has no meaning here, or a meaning and does not exist."""
    with_odometry, with_imu = map(_opened, _BASES)
    inputs = list(dict.fromkeys([*with_odometry.inputs, *with_imu.inputs]))
    unused = _MEANINGS.keys() - {entry.name for entry in (*inputs, *with_imu.outputs, *with_imu.services)}
    if unused:
        raise KeyError(f"the node does not open {', '.join(sorted(unused))}")
    return replace(with_imu, inputs=inputs)


def _opened(base: list[str]) -> Interface:
    """What the node opens with these arguments."""
    with _ros(base):
        of_every_node = _of_every_node()
        node = GeomidNode()
        try:
            known = {entry.name for entry in of_every_node}
            inputs = _entries(known, ((s.topic_name, s.msg_type, s.qos_profile) for s in node.subscriptions))
            outputs = _entries(known, ((p.topic_name, p.msg_type, p.qos_profile) for p in node.publishers))
            services = _entries(known, ((s.service_name, s.srv_type, None) for s in node.services))
        finally:
            node.close()
            node.destroy_node()
    return Interface(inputs, outputs, services, of_every_node)


@contextmanager
def _ros(base: list[str]) -> Iterator[None]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"  # nobody hears of this node
    rclpy.init(args=[*_ARGUMENTS, *_SENSOR, *base], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.shutdown()


def _of_every_node() -> list[Entry]:
    node = Node(_NAME)
    try:
        found = [
            (node.get_subscriber_names_and_types_by_node, "subscribed, with `use_sim_time`"),
            (node.get_publisher_names_and_types_by_node, "published"),
            (node.get_service_names_and_types_by_node, "served"),
        ]
        return [
            Entry(_relative(name), kinds[0], "", direction)
            for names_and_types, direction in found
            for name, kinds in sorted(names_and_types(_NAME, _NAMESPACE))
        ]
    finally:
        node.destroy_node()


def _entries(known: set[str], found: Iterable[tuple[str, Any, QoSProfile | None]]) -> list[Entry]:
    own = [(_relative(name), kind, qos) for name, kind, qos in found if _relative(name) not in known]
    return [Entry(name, _type_name(kind), _qos_text(qos) if qos else "", _MEANINGS[name]) for name, kind, qos in own]


def _relative(name: str) -> str:
    """A full name as the node has said it."""
    private = f"{_NAMESPACE}/{_NAME}/"
    if name.startswith(private):
        return f"~/{name.removeprefix(private)}"
    return name.removeprefix(f"{_NAMESPACE}/")


def _type_name(kind: Any) -> str:
    package, folder = kind.__module__.split(".")[:2]
    return f"{package}/{folder}/{kind.__name__}"


def _qos_text(qos: QoSProfile) -> str:
    reliability = "best effort" if qos.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable"
    latched = ", transient local" if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL else ""
    return f"{reliability}{latched}, last {qos.depth}"
