"""The catalogue's faults between the node and others: quality of service, clocks, publishers too many, any bytes."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rclpy
from files.recordings import TYPES, Recorded
from geometry_msgs.msg import InertiaStamped
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from .observer import MATCHING, latched, plenty
from .rig import ERROR, OK, WARN, Rig
from .spoiling import BETWEEN, changed, in_frame, later
from .stage import NO_CHOICE, Stage, description, messages, staged
from .test_catalogue_console import SHOWN, WICKED, said
from .test_solving_process import children

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


def publish(stage: Stage, publisher: Any, count: int) -> None:
    for item in JOINTS[:count]:
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


MALFORMED = {
    "a header alone": b"\x00\x01\x00\x00",
    "an end too soon": b"\x00\x01\x00\x00" + 20 * b"\x01",
    "a length that is not there": b"\x00\x01\x00\x00" + 16 * b"\x00" + 8 * b"\xff",
}


TWO = "joint_states has 2 publishers"


@contextmanager
def impostor(rig: Rig) -> Iterator[Publisher]:
    """Another node that publishes joint_states."""
    node = rclpy.create_node("impostor", context=rig.stage.observer.node.context)
    publisher = node.create_publisher(JointState, "/joint_states", plenty())
    rig.stage.observer.wait_for(publisher.get_subscription_count, "the node")
    rig.says(len(rig.arrays), ERROR, TWO)
    rig.stage.observer.spin(MATCHING)
    try:
        yield publisher
    finally:
        node.destroy_node()
        begin = len(rig.arrays)
        rig.told("the impostor's end", begin, lambda _, status: TWO not in status.message)
        rig.stage.observer.spin(0.2)


def phantom(item: Recorded) -> Recorded:
    return item.changed(name=[f"ghost/{name}" for name in item.message.name])


def right_arm(item: Recorded) -> Recorded:
    first = {key: getattr(item.message, key)[:1] for key in ("position", "velocity", "effort")}
    return item.changed(name=item.message.name[:1], **first)


SECONDS: dict[str, Callable[[Recorded], Recorded]] = {
    "14-two-publishers": lambda item: item,
    "15-a-phantom": phantom,
    "16-an-arm-of-its-own": right_arm,
}


def test_a_second_publisher_is_named_and_believed_no_more_than_the_first(rig: Rig) -> None:
    """Whatever it says; the wrenches go on."""
    before, after = rig.begin()
    rig.feed(before)
    rig.published()
    begin = len(rig.arrays)
    with impostor(rig) as publisher:
        for item in after[:40]:
            if item.topic == "/joint_states":
                rig.send([item])
                for say in SECONDS.values():
                    other = later(say(item), 1_000_000)
                    publisher.publish(bytes(TYPES.serialize_cdr(other.message, other.kind)))
                    rig.sent["/joint_states"] += 1
        rig.settled(begin)
        rig.says(begin, ERROR, TWO, "/impostor, /observer")
    assert rig.node.running
    rig.feed(after[40:])
    rig.assert_same_as_twin()


def test_17_a_publisher_that_is_replaced(rig: Rig) -> None:
    """Its successor's messages are taken as its own, once all that it has sent has come and it has gone. A healthy
    stream is nothing to talk about: the judgement is of now."""
    before, after = rig.begin()
    rig.feed(before)
    rig.settled(len(rig.arrays))
    node, old = rig.stage.observer.node, rig.publishers["/joint_states"]
    rig.publishers["/joint_states"] = node.create_publisher(JointState, "/joint_states", plenty())
    rig.says(len(rig.arrays), ERROR, TWO)
    node.destroy_publisher(old)
    begin = len(rig.arrays)
    rig.told("its end", begin, lambda _, status: TWO not in status.message)
    rig.says(begin, WARN, "no messages on /joint_states")
    begin = len(rig.arrays)
    rig.feed(after)
    rig.told("good words", begin, lambda _, status: status.level == OK)
    rig.settled(begin)
    rig.assert_same_as_twin()


def test_108_104_what_is_no_message_is_refused_and_said_on_the_console(rig: Rig) -> None:
    """Whoever publishes may publish any bytes, and any names: they are one printable line, there and in the
    diagnostics. With what to do about it, if all messages are refused."""
    before, after = rig.begin()
    rig.feed(before)
    rig.published()
    for data in MALFORMED.values():
        begin = len(rig.arrays)
        for topic, publisher in rig.publishers.items():
            publisher.publish(data)
            rig.sent[topic] += 1
        rig.names_at_once(
            begin,
            WARN,
            "joint_states rejected: not a valid sensor_msgs/msg/JointState",
            "/wrench rejected: not a valid geometry_msgs/msg/WrenchStamped",
        )
    accepted, begin = rig.settled(begin)["joint_states accepted"], len(rig.arrays)
    last = {item.topic: item for item in before}
    rig.send(100 * [changed(last["/joint_states"], name=[WICKED, "joint2", "joint3"])], pause=0.04)
    lacking = r"joint_states rejected: joint 'joint1' is missing: if nobody publishes"
    rig.wait_for(lambda: said(rig.node, "(WARN|ERROR)", lacking), "what all messages lack")
    assert rig.node.output.count("joint 'joint1' is missing") <= 2, "once, not with every message"
    assert rig.settled(begin)["joint_states accepted"] == accepted
    begin = len(rig.arrays)
    wicked = changed(last["/joint_states"], name=[WICKED, WICKED, "joint3"])
    rig.send([wicked, later(in_frame(last["/wrench"], WICKED), BETWEEN)])
    rig.says(begin, None, f"joint '{SHOWN}' is named twice", f"frame '{SHOWN}' is not the declared 'wrist_ft'")
    for status in (status for array in rig.arrays for status in array.status):
        values = [text for pair in status.values for text in (pair.key, pair.value)]
        assert all(text.isprintable() for text in (status.name, status.message, *values)), status
    assert all(line.isprintable() for line in rig.node.output.splitlines())
    assert not re.search("^INFO all is well", rig.node.output, re.MULTILINE)
    rig.feed(after)
    rig.assert_same_as_twin()


def test_91_a_node_whose_process_is_killed_goes_on(rig: Rig) -> None:
    """It is said, no message is lost to it, and the estimate is that of a node to which it did not happen. Last, as it
    is said for a minute."""
    before, after = rig.begin()
    rig.feed(before)
    rig.published()
    refused, begin = not_accepted(rig.settled(len(rig.arrays))), len(rig.arrays)
    for process in children(rig.node.pid):
        os.kill(process, signal.SIGKILL)
    rig.feed(after)
    rig.says(begin, WARN, "the solver process died")
    assert not_accepted(rig.settled(begin)) == refused
    rig.assert_same_as_twin()
    rig.says(begin, WARN, "was restarted")


def not_accepted(values: dict[str, str]) -> int:
    return int(values["joint_states received"]) - int(values["joint_states accepted"])
