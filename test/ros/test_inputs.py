"""Data wait in the subscription until they are looked for."""

from __future__ import annotations

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from geomid_ros.ros.inputs import Inputs
from geomid_ros.signals.ledger import Ledger

from .domains import free_domain
from .observer import Observer, plenty

TOPIC, COUNT = "joint_states", 5


def test_the_executor_leaves_data_alone() -> None:
    with free_domain() as domain, Observer(domain, lambda: 0.0) as observer:
        taken: list[bytes] = []
        inputs = Inputs(observer.node, Ledger(), lambda what, error: pytest.fail(f"{what}: {error}"))
        inputs.listen(JointState, TOPIC, lambda _, data: taken.append(data) or "")
        heard = observer.collect(JointState, TOPIC)
        publisher = observer.node.create_publisher(JointState, TOPIC, plenty())
        observer.wait_for(lambda: publisher.get_subscription_count() == 2, "both subscriptions")
        sent = [JointState(name=[f"joint{number}"]) for number in range(COUNT)]
        for message in sent:
            publisher.publish(message)
        observer.wait_for(lambda: len(heard) == COUNT, "what another subscription hears")
        assert heard == sent
        assert not taken
        observer.wait_for(lambda: inputs.take_waiting() or len(taken) == COUNT, "what waits")
        assert [deserialize_message(data, JointState) for data in taken] == sent
