"""Ways to a joint_trajectory_controller; the action on a stub (:mod:`.actions`)."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rclpy.action import client as rclpy_client
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.controller import ActionController, TopicController, find_controller, message_of

from .actions import Client, FollowJointTrajectory, ended
from .stage import Stage

NAME = "/arm_controller"
MOTION = Trajectory(("a", "b"), np.array([0.5, 2.25]), np.array([[1, 2], [3, 4]]), np.zeros((2, 2)), np.ones((2, 2)))


def test_goals_of_the_action() -> None:
    """A goal is the trajectory, and may succeed; why one does not is told, unless another has replaced it."""
    controller = ActionController(None, NAME, FollowJointTrajectory, Client)  # the stub needs no node
    server, result = Client.last, FollowJointTrajectory.Result
    assert server.name == "/arm_controller/follow_joint_trajectory"
    controller.send(MOTION)
    assert server.goals[0][0].trajectory == message_of(MOTION)
    server.accept(0).ended.fulfil(ended(result.SUCCESSFUL))
    assert controller.problem == ""
    controller.send(MOTION)
    replaced = server.accept(1)
    controller.send(MOTION)
    replaced.ended.fulfil(ended(result.PATH_TOLERANCE_VIOLATED, "preempted"))
    assert controller.problem == ""
    server.accept(2).ended.fulfil(ended(result.PATH_TOLERANCE_VIOLATED, "path tolerance"))
    assert controller.problem == "the controller aborted the motion: path tolerance"
    controller.send(MOTION)
    server.goals[3][1].fulfil(SimpleNamespace(accepted=False))
    assert "aborted the motion: not accepted" in controller.problem


def test_a_server_that_goes_is_told() -> None:
    controller = ActionController(None, NAME, FollowJointTrajectory, Client)
    assert controller.ready
    Client.last.there = False
    assert not controller.ready
    assert "the controller is gone: nothing serves /arm_controller/follow_joint_trajectory" in controller.problem


def test_the_topic_is_taken_where_there_is_no_action(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    node, look = stage.observer.node, lambda: stage.observer.spin(0.01)
    heard: list[JointTrajectory] = []
    subscription = node.create_subscription(JointTrajectory, f"{NAME}/joint_trajectory", heard.append, 10)
    found = find_controller(node, NAME, look)
    assert isinstance(found, TopicController)
    found.send(MOTION)
    stage.observer.wait_for(lambda: heard, "the trajectory")
    assert heard == [message_of(MOTION)]
    actions = ModuleType("control_msgs.action")
    actions.FollowJointTrajectory = FollowJointTrajectory  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "control_msgs", ModuleType("control_msgs"))
    monkeypatch.setitem(sys.modules, "control_msgs.action", actions)
    monkeypatch.setattr(rclpy_client, "ActionClient", Client)
    assert isinstance(find_controller(node, NAME, look), ActionController)
    assert found.problem == ""
    node.destroy_subscription(subscription)
    stage.observer.wait_for(lambda: not found.ready, "its end")
    assert found.problem == f"the controller is gone: nothing subscribes to {NAME}/joint_trajectory any more"
