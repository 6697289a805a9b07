"""Data wait in the subscription until they are looked for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from geomid_ros.live.effort_predictor import Predicted
from geomid_ros.live.threads import Received
from geomid_ros.ros.inputs import Inputs
from geomid_ros.ros.outputs import serialised
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.ledger import Account, Ledger

from .domains import free_domain
from .observer import Observer, plenty

TOPIC, COUNT = "joint_states", 5


class Hearing:
    """Inputs of a node, and publishers that they know."""

    def __init__(self, observer: Observer) -> None:
        self.observer, self.ledger, self.taken = observer, Ledger(), list[Received]()
        self.inputs = Inputs(observer.node, self.ledger)

    def publisher(self, kind: type, topic: str, listeners: int = 1) -> Publisher:
        publisher = self.observer.node.create_publisher(kind, topic, plenty())
        self.observer.wait_for(lambda: publisher.get_subscription_count() == listeners, "the subscription")
        return publisher

    def takes(self, count: int, topic: str | None = None) -> None:
        """Wait until so many messages have been taken, of all topics or of one that is looked at alone."""
        take = self.inputs.poll if topic is None else partial(self.inputs.poll, topic)
        self.observer.wait_for(lambda: self.taken.extend(take()) or len(self.taken) == count, "what waits")


@pytest.fixture
def hearing() -> Iterator[Hearing]:
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        hearing = Hearing(observer)
        hearing.inputs.subscribe_data(JointState, TOPIC)
        yield hearing


def test_the_executor_leaves_data_alone(hearing: Hearing) -> None:
    begin = time.perf_counter()
    heard = hearing.observer.collect(JointState, TOPIC)
    publisher = hearing.publisher(JointState, TOPIC, 2)
    sent = [JointState(name=[f"joint{number}"]) for number in range(COUNT)]
    for message in sent:
        publisher.publish(message)
    hearing.observer.wait_for(lambda: len(heard) == COUNT, "what another subscription hears")
    assert heard == sent
    time.sleep(0.2)
    asked = time.perf_counter()
    hearing.takes(COUNT)
    assert [deserialize_message(message.data, JointState) for message in hearing.taken] == sent
    assert all(begin < message.time < asked - 0.1 for message in hearing.taken), "when they came, not when taken"


def test_data_of_several_topics_are_in_the_order_in_which_they_came(hearing: Hearing) -> None:
    """A clock that is set back is then set back for all of them at once."""
    hearing.inputs.subscribe_data(WrenchStamped, "wrench")
    publishers = [
        (hearing.publisher(type(message), topic), message)
        for topic, message in ((TOPIC, JointState()), ("wrench", WrenchStamped()))
    ]
    for publisher, message in publishers * COUNT:
        publisher.publish(message)
        time.sleep(0.02)
    hearing.takes(2 * COUNT)
    assert [message.topic for message in hearing.taken] == [TOPIC, "wrench"] * COUNT


def test_a_topic_keeps_its_order_though_the_wall_clock_is_set(
    hearing: Hearing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is looked at alone; what came on others waits."""
    real = time.time
    hearing.inputs.subscribe_data(WrenchStamped, "wrench")
    states, wrenches = hearing.publisher(JointState, TOPIC), hearing.publisher(WrenchStamped, "wrench")
    wrenches.publish(WrenchStamped())
    for count, set_by in enumerate((0.0, 1000.0, -1000.0), 1):
        monkeypatch.setattr(time, "time", lambda ahead=set_by: real() + ahead)
        states.publish(JointState())
        hearing.takes(count, TOPIC)
    assert hearing.taken == sorted(hearing.taken, key=lambda message: message.time)
    assert hearing.taken[-1].time <= time.perf_counter()
    hearing.takes(4)
    assert [message.topic for message in hearing.taken] == [TOPIC, TOPIC, TOPIC, "wrench"]


def test_every_message_is_taken_lost_or_dropped(hearing: Hearing) -> None:
    """More than the queue holds, and one more publisher than there may be."""
    publisher, sent = hearing.publisher(JointState, TOPIC), 0

    def counted() -> bool:
        hearing.taken.extend(hearing.inputs.poll())
        account = hearing.ledger.topics.get(TOPIC, Account())
        return len(hearing.taken) + account.lost + account.dropped.total() == sent

    for count in (1, 1500, 1, 3):
        if count == 3:
            before = len(hearing.taken)
            hearing.publisher(JointState, TOPIC)
        for _ in range(count):
            publisher.publish(JointState())
        sent += count
        hearing.observer.wait_for(counted, "all messages")
    assert hearing.ledger.topics[TOPIC].lost > 0
    assert hearing.ledger.topics[TOPIC].dropped == {"several publishers": 3}
    assert len(hearing.taken) == before


def test_what_the_configuration_asks_for_is_taken(hearing: Hearing) -> None:
    """Commands; joint states of several publishers if they are merged, and only then."""
    asking, taken = Inputs(hearing.observer.node, Ledger()), list[Received]()
    asking.listen_as(Configuration({"merge_joint_states": True, "command.gains": ["20:1"]}))
    publishers = [hearing.publisher(JointState, topic, 2) for topic in (TOPIC, TOPIC)]
    for publisher in (*publishers, hearing.publisher(JointState, "joint_commands")):
        publisher.publish(JointState())
    hearing.observer.wait_for(lambda: taken.extend(asking.poll()) or len(taken) == 3, "all messages")
    assert sorted(message.topic for message in taken) == ["joint_commands", TOPIC, TOPIC]
    assert asking.problems == ()
    (problem,) = hearing.inputs.problems
    assert problem.startswith("/joint_states has 2 publishers; all its messages are dropped until one is left")


@pytest.mark.parametrize("joints", [("a",), ("ab",), ("joint1", "j2", "joint_33"), tuple(f"j{n}" for n in range(30))])
def test_bytes_are_those_of_messages(joints: tuple[str, ...]) -> None:
    random, stamps = np.random.default_rng(0), np.array([1_700_000_000_123_456_789, 5, 999_999_999])
    predicted = Predicted(joints, stamps, random.normal(size=(3, 3, len(joints))), random.normal(size=(3, len(joints))))
    messages = [deserialize_message(data, JointState) for data in serialised(predicted)]
    assert [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages] == stamps.tolist()
    assert all(tuple(message.name) == joints for message in messages)
    np.testing.assert_array_equal([message.position for message in messages], predicted.motion[0])
    np.testing.assert_array_equal([message.velocity for message in messages], predicted.motion[1])
    np.testing.assert_array_equal([message.effort for message in messages], predicted.efforts)
