"""Data wait in the subscription until they are looked for."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from geomid_ros.live.effort_predictor import Predicted
from geomid_ros.live.inbox import Received
from geomid_ros.ros.inputs import Inputs
from geomid_ros.ros.outputs import serialised
from geomid_ros.signals.ledger import Account, Ledger

from .domains import free_domain
from .observer import Observer, plenty

TOPIC, COUNT = "joint_states", 5


def test_the_executor_leaves_data_alone() -> None:
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        begin = time.perf_counter()
        inputs = Inputs(observer.node, Ledger())
        inputs.subscribe_data(JointState, TOPIC)
        heard = observer.collect(JointState, TOPIC)
        publisher = observer.node.create_publisher(JointState, TOPIC, plenty())
        observer.wait_for(lambda: publisher.get_subscription_count() == 2, "both subscriptions")
        sent = [JointState(name=[f"joint{number}"]) for number in range(COUNT)]
        for message in sent:
            publisher.publish(message)
        observer.wait_for(lambda: len(heard) == COUNT, "what another subscription hears")
        assert heard == sent
        time.sleep(0.2)
        asked = time.perf_counter()
        taken: list[Received] = []
        observer.wait_for(lambda: taken.extend(inputs.poll()) or len(taken) == COUNT, "what waits")
        assert [deserialize_message(message.data, JointState) for message in taken] == sent
        assert all(begin < message.time < asked - 0.1 for message in taken), "when they came, not when they were taken"


def test_data_of_several_topics_are_in_the_order_in_which_they_came() -> None:
    """A clock that is set back is then set back for all of them at once."""
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        inputs = Inputs(observer.node, Ledger())
        inputs.subscribe_data(JointState, TOPIC)
        inputs.subscribe_data(WrenchStamped, "wrench")
        states = observer.node.create_publisher(JointState, TOPIC, plenty())
        wrenches = observer.node.create_publisher(WrenchStamped, "wrench", plenty())
        publishers = [(states, JointState()), (wrenches, WrenchStamped())]
        observer.wait_for(lambda: all(p.get_subscription_count() == 1 for p, _ in publishers), "both subscriptions")
        for publisher, message in publishers * COUNT:
            publisher.publish(message)
            time.sleep(0.02)
        taken: list[Received] = []
        observer.wait_for(lambda: taken.extend(inputs.poll()) or len(taken) == 2 * COUNT, "what waits")
        assert [message.topic for message in taken] == [TOPIC, "wrench"] * COUNT


def test_a_topic_keeps_its_order_though_the_wall_clock_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is looked at alone; what came on others waits."""
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        inputs, real = Inputs(observer.node, Ledger()), time.time
        inputs.subscribe_data(JointState, TOPIC)
        inputs.subscribe_data(WrenchStamped, "wrench")
        states = observer.node.create_publisher(JointState, TOPIC, plenty())
        wrenches = observer.node.create_publisher(WrenchStamped, "wrench", plenty())
        observer.wait_for(lambda: all(p.get_subscription_count() == 1 for p in (states, wrenches)), "subscriptions")
        wrenches.publish(WrenchStamped())
        taken: list[Received] = []

        def looked(topic: str | None, count: int) -> bool:
            taken.extend(inputs.poll(topic))
            return len(taken) == count

        for count, set_by in enumerate((0.0, 1000.0, -1000.0), 1):
            monkeypatch.setattr(time, "time", lambda ahead=set_by: real() + ahead)
            states.publish(JointState())
            observer.wait_for(partial(looked, TOPIC, count), "what waits")
        assert taken == sorted(taken, key=lambda message: message.time)
        assert taken[-1].time <= time.perf_counter()
        observer.wait_for(partial(looked, None, 4), "the other topic")
        assert [message.topic for message in taken] == [TOPIC, TOPIC, TOPIC, "wrench"]


def test_every_message_is_taken_lost_or_dropped() -> None:
    """More than the queue holds, and one more publisher than there may be."""
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        ledger = Ledger()
        inputs = Inputs(observer.node, ledger)
        inputs.subscribe_data(JointState, TOPIC)
        publisher = observer.node.create_publisher(JointState, TOPIC, plenty())
        observer.wait_for(lambda: publisher.get_subscription_count() == 1, "the subscription")
        taken: list[Received] = []

        def counted(sent: int) -> bool:
            taken.extend(inputs.poll())
            account = ledger.topics.get(TOPIC, Account())
            return len(taken) + account.lost + account.dropped.total() == sent

        publisher.publish(JointState())
        observer.wait_for(lambda: counted(1), "the first message")
        for _ in range(1500):
            publisher.publish(JointState())
        observer.wait_for(lambda: counted(1501), "all messages")
        assert ledger.topics[TOPIC].lost > 0
        publisher.publish(JointState())
        observer.wait_for(lambda: counted(1502), "one more")
        before = len(taken)
        other = observer.node.create_publisher(JointState, TOPIC, plenty())
        observer.wait_for(lambda: other.get_subscription_count() == 1, "the subscription")
        for _ in range(3):
            publisher.publish(JointState())
        observer.wait_for(lambda: counted(1505), "what is dropped")
        assert ledger.topics[TOPIC].dropped == {"several publishers": 3}
        assert len(taken) == before


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
