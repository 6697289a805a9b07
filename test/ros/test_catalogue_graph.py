"""The catalogue's faults between the node and others: quality of service, clocks, messages that are lost."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from files.recordings import TYPES
from geometry_msgs.msg import InertiaStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from .observer import MATCHING, latched, plenty
from .rig import ERROR, WARN
from .stage import NO_CHOICE, Stage, description, messages, staged

JOINTS = [item for item in messages() if item.topic == "/joint_states"]


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    """A node that wants its joint states reliable, lives in simulated time, and has no robot yet."""
    with staged(tmp_path_factory.mktemp("strict")) as stage:
        overrides = {"/joint_states": {"subscription": {"reliability": "reliable", "depth": 100}}}
        stage.node({"use_sim_time": True, "qos_overrides": overrides, "solve_period": 0.2, **NO_CHOICE})
        yield stage


def told(stage: Stage, level: bytes, *parts: str) -> dict[str, str]:
    """The values of the first diagnostics from now on that say all parts."""
    array = stage.observer.diagnostics(
        lambda _, status: status.level == level and all(part in status.message for part in parts), str(parts)
    )
    return {pair.key: pair.value for pair in array.status[0].values}


def publish(stage: Stage, publisher: Any, count: int, begin: int = 0) -> None:
    for item in JOINTS[begin : begin + count]:
        publisher.publish(bytes(TYPES.serialize_cdr(item.message, item.kind)))
        stage.observer.spin(0.0005)


def test_29_simulated_time_without_a_clock(strict: Stage) -> None:
    told(strict, WARN, "use_sim_time is set, but there are no messages on /clock")
    clock = strict.observer.node.create_publisher(Clock, "/clock", 10)
    strict.observer.wait_for(clock.get_subscription_count, "the node")
    strict.observer.spin(MATCHING)
    message = Clock()
    message.clock.sec = 5
    clock.publish(message)
    strict.observer.diagnostics(lambda _, status: "/clock" not in status.message, "no complaint")
    strict.observer.node.destroy_publisher(clock)


def test_33_a_description_that_is_not_kept_for_those_who_come_late(strict: Stage) -> None:
    volatile = QoSProfile(depth=1, durability=DurabilityPolicy.VOLATILE)
    talker = strict.observer.node.create_publisher(String, "/robot_description", volatile)
    told(strict, ERROR, "robot_description: no messages from /observer", "QoS: durability")
    strict.observer.node.destroy_publisher(talker)
    told(strict, WARN, "no robot description yet")
    talker = strict.observer.node.create_publisher(String, "/robot_description", latched(1))
    talker.publish(String(data=description("arm3")))
    told(strict, WARN, "no messages on /joint_states")


def test_34_joint_states_less_reliable_than_is_asked_for(strict: Stage) -> None:
    node = strict.observer.node
    sloppy = node.create_publisher(
        JointState, "/joint_states", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    values = told(strict, ERROR, "/joint_states: no messages from /observer", "QoS: reliability")
    assert "joint_states received" not in values, "nothing came, and nothing is counted"
    node.destroy_publisher(sloppy)
    inertias = strict.observer.collect(InertiaStamped, "/geomid/inertias", latched())
    good = node.create_publisher(JointState, "/joint_states", plenty())
    strict.observer.wait_for(good.get_subscription_count, "the node")
    strict.observer.spin(MATCHING)
    publish(strict, good, 400)
    strict.observer.wait_for(lambda: inertias, "estimates as if nothing had been")
    strict.fed({"joint_states": 400})
    node.destroy_publisher(good)


def test_30_messages_that_are_lost_on_the_way_are_counted(stage: Stage, tmp_path: Path) -> None:
    """The process stands still while more comes than its middleware keeps."""
    process = stage.node(
        {"robot_description": description("arm3"), **NO_CHOICE, "output_folder": str(tmp_path / "out")}
    )
    node = stage.observer.node
    hasty = node.create_publisher(
        JointState, "/joint_states", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    stage.observer.wait_for(hasty.get_subscription_count, "the node")
    stage.observer.spin(MATCHING)
    publish(stage, hasty, 300)
    stage.fed({"joint_states": 300})
    process.send(signal.SIGSTOP)
    try:
        raw = [bytes(TYPES.serialize_cdr(item.message, item.kind)) for item in JOINTS]
        for _ in range(20):
            for data in raw:
                hasty.publish(data)
    finally:
        process.send(signal.SIGCONT)
    publish(stage, hasty, 100, 700)
    sent = 300 + 20 * len(JOINTS) + 100

    def accounted(values: dict[str, str], _: Any) -> bool:
        return int(values["joint_states received"]) + int(values.get("joint_states lost", "0")) == sent

    array = stage.observer.diagnostics(accounted, f"{sent} messages received or lost")
    values = {pair.key: pair.value for pair in array.status[0].values}
    assert int(values["joint_states lost"]) > 0
    assert process.running
