"""What is not streamed is said once, to those who subscribe."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from excitation.motions import lively
from files.recordings import BAGS
from live.test_stream import JOINTS, identification, messages
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import geomid_ros
from geomid_ros.api.feedforward import robot_to_move
from geomid_ros.checks.verdict import USABLE
from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live.effort_predictor import EffortPredictor
from geomid_ros.live.threads import Received
from geomid_ros.ros.node import GeomidNode
from geomid_ros.ros.outputs import Streaming, ros_time
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import FillOptions
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES

from .observer import MATCHING, latched
from .stage import NO_CHOICE, Stage, description
from .stage import messages as messages_of

__all__ = ["identification"]
HELD = {
    "wrenches": ["hand"],
    "wrench.hand.topic": "/hand",
    "wrench.hand.frame": "link3",
    "wrench.hand.role": "external",
}


class Handle(AbstractContextManager[None]):
    """A publisher, as rclpy wraps it."""

    def __init__(self, publish_raw: Callable[[bytes], None]) -> None:
        self.publish_raw = publish_raw

    def __exit__(self, *_: object) -> None:
        """Nothing is to be done."""


class Listened:
    """What a node's ``subscribers`` hear of its stream, and what it logs."""

    def __init__(self, subscribers: int = 1) -> None:
        self.logged: list[str] = []
        self.streamed: list[bytes] = []
        self.waiting: list[Received] = []
        publisher = SimpleNamespace(
            topic_name="/geomid/streamed_joint_states",
            get_subscription_count=lambda: subscribers,
            handle=Handle(self.streamed.append),
        )
        node: Any = SimpleNamespace(
            context=SimpleNamespace(ok=lambda: True),
            create_publisher=lambda *_: publisher,
        )
        inputs: Any = SimpleNamespace(poll=self._take, only_streams_commands=False)
        self.predictor = EffortPredictor()
        self.streaming = Streaming(node, inputs, {JOINT_STATES: self.predictor}, self.logged.append)

    def _take(self, topic: str | None = None) -> list[Received]:
        taken = [message for message in self.waiting if topic in (None, message.topic)]
        self.waiting = [message for message in self.waiting if message not in taken]
        return taken

    def hear(self, sent: list[bytes]) -> None:
        """Let messages come."""
        self.waiting = [Received(JOINT_STATES, data, 0.0) for data in sent]
        self.streaming.wait(0.02)
        while self.waiting and self.predictor.ready:  # the machine is busy
            self.streaming.wait(0.02)


def test_messages_that_were_predicted_are_taken_with_all_others_as_they_came(
    identification: geomid_ros.Identification,
) -> None:
    listened = Listened()
    listened.predictor.set_model(identification.session, identification.estimate)
    wrenches = [Received("/wrench", b"", time) for time in (1.5, 2.5)]
    states = [Received(JOINT_STATES, data, time) for time, data in enumerate(messages()[:3], 1)]
    listened.waiting = [*wrenches, *states[:2]]
    while states[1] in listened.waiting:
        listened.streaming.wait(0.02)
    assert len(listened.streamed) == 2
    assert listened.waiting == wrenches
    listened.waiting.append(states[2])
    assert [message.time for message in listened.streaming.drain()] == [1, 1.5, 2, 2.5, 3]
    assert listened.streaming.drain() == []
    assert len(listened.streamed) == 3, "what came last is predicted, too"


def session(**parameters: Any) -> Session:
    """Of the arm's URDF."""
    return Session(read_urdf(BAGS / "arm3.urdf"), Configuration(parameters), "arm3.urdf")


@pytest.mark.parametrize(("merge", "why"), [(False, "joint 'joint3' is missing"), (True, "only some joints")])
def test_a_message_that_cannot_be_predicted_is_told_once(
    merge: bool, why: str, identification: geomid_ros.Identification
) -> None:
    listened = Listened()
    listened.predictor.set_model(session(merge_joint_states=merge), identification.estimate)
    part = messages(("joint1", "joint2"))[:3]
    for _ in range(2):
        listened.hear([*part, *messages()[:2]])
    assert len(listened.streamed) == 4
    (said,) = listened.logged
    assert said.startswith("/geomid/streamed_joint_states lacks messages: ")
    assert why in said


@pytest.mark.parametrize(("floating", "why"), [(True, "the motion of the base"), (False, "external wrenches")])
@pytest.mark.parametrize("subscribers", [0, 1])
def test_a_robot_that_cannot_be_predicted_is_told_who_subscribes(
    floating: bool, why: str, subscribers: int, identification: geomid_ros.Identification
) -> None:
    listened = Listened(subscribers)
    listened.predictor.set_model(session(floating_base=floating, **HELD), identification.estimate)
    for _ in range(2):
        listened.hear(messages()[:2])
    assert not listened.streamed
    assert len(listened.logged) == subscribers
    assert all(why in text for text in listened.logged)


@pytest.mark.parametrize("active", [False, True])
def test_messages_are_taken_once_more_in_a_pause_unless_they_are_predicted(active: bool) -> None:
    """Predicted ones are kept for the next pass, as many at once."""
    done: list[Any] = []
    streaming = SimpleNamespace(active=active, wait=done.append)
    node: Any = SimpleNamespace(_streaming=streaming, take_waiting=lambda: done.append("taken"))
    GeomidNode.wait(node, 1.0)
    assert done == ([1.0] if active else [0.5, "taken", 0.5])


def test_commands_are_streamed_with_the_efforts_that_motors_need(stage: Stage) -> None:
    """By the last estimate that later data confirm, while somebody subscribes; identification does not use them."""
    observer, recorded = stage.observer, messages_of("arm3")
    stage.node({"robot_description": description("arm3"), **NO_CHOICE})
    estimates = observer.collect(String, "/geomid/estimate", latched())
    observer.publish(recorded[:600], {"/joint_states": JointState})
    observer.wait_for(lambda: estimates, "an estimate")
    observer.publish(recorded[600:], {"/joint_states": JointState})
    observer.wait_for(lambda: json.loads(estimates[-1].data)["verdict"]["result"] == USABLE, "a usable one")
    commands = observer.node.create_publisher(JointState, "/joint_commands", 10)
    observer.spin(MATCHING)
    assert not commands.get_subscription_count()
    streamed = observer.collect(JointState, "/geomid/streamed_joint_commands")
    observer.wait_for(commands.get_subscription_count, "the node")
    observer.spin(MATCHING)
    times = np.arange(0.0, 1.0, 0.01)
    motion = np.array([lively(JOINTS, 1.0, 0.4).rows(times, order) for order in range(3)])
    for time, position, velocity in zip(times, *motion[:2], strict=True):
        message = JointState(name=JOINTS, position=position.tolist(), velocity=velocity.tolist())
        message.header.stamp = ros_time(10**9 + round(1e9 * time))
        commands.publish(message)
        observer.spin(0.002)
    observer.wait_for(lambda: len(streamed) == len(times), "all commands with efforts")
    file = EstimateFile.parse(estimates[-1].data, "the estimate")
    session = robot_to_move(FillOptions(), file)
    efforts = MotorEfforts(session.model, session.known_parameters, session.effort_gains, JOINTS, "the motion")
    errors = np.array([message.effort for message in streamed]) - efforts(motion)
    assert np.max(np.abs(errors[20:])) < 0.05 * np.max(np.abs(efforts(motion))), "accelerations lag"
    values = observer.diagnostics(lambda *_: True, "diagnostics").status[0].values
    assert not [pair.key for pair in values if pair.key.startswith("joint_commands")]
