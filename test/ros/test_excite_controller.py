"""Ways to a joint_trajectory_controller; the action on a stub (:mod:`.actions`)."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rclpy.action import client as rclpy_client

from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.controller import ActionController, TopicController, find_controller, message_of

from .actions import Client, FollowJointTrajectory, ended
from .stage import Stage

NAME = "/arm_controller"
MOTION = Trajectory(("a", "b"), np.array([0.5, 2.25]), np.array([[1, 2], [3, 4]]), np.zeros((2, 2)), np.ones((2, 2)))


@pytest.fixture
def controller() -> ActionController:
    # The stub needs no node.
    return ActionController(None, NAME, FollowJointTrajectory, Client)


def test_a_goal_is_the_trajectory_and_may_succeed(controller: ActionController) -> None:
    controller.send(MOTION)
    assert Client.last.name == "/arm_controller/follow_joint_trajectory"
    assert Client.last.goals[0][0].trajectory == message_of(MOTION)
    Client.last.accept(0).ended.fulfil(ended(FollowJointTrajectory.Result.SUCCESSFUL))
    assert controller.problem == ""


def test_a_goal_that_is_not_accepted_is_told(controller: ActionController) -> None:
    controller.send(MOTION)
    Client.last.goals[0][1].fulfil(SimpleNamespace(accepted=False))
    assert "aborted the motion: not accepted" in controller.problem


def test_a_goal_that_is_aborted_is_told(controller: ActionController) -> None:
    controller.send(MOTION)
    Client.last.accept(0).ended.fulfil(ended(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "path tolerance"))
    assert controller.problem == "the controller aborted the motion: path tolerance"


def test_a_goal_that_was_replaced_may_fail(controller: ActionController) -> None:
    controller.send(MOTION)
    sent = Client.last.accept(0)
    controller.send(MOTION)
    sent.ended.fulfil(ended(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "preempted"))
    assert controller.problem == ""


def test_a_server_that_goes_is_told(controller: ActionController) -> None:
    Client.last.there = False
    assert not controller.ready
    assert "the controller is gone: nothing serves /arm_controller/follow_joint_trajectory" in controller.problem


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """``control_msgs``, as far as it is needed."""
    package, actions = ModuleType("control_msgs"), ModuleType("control_msgs.action")
    actions.FollowJointTrajectory = FollowJointTrajectory  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "control_msgs", package)
    monkeypatch.setitem(sys.modules, "control_msgs.action", actions)
    monkeypatch.setattr(rclpy_client, "ActionClient", Client)


@pytest.mark.usefixtures("installed")
def test_the_action_is_taken_where_there_is_one(stage: Stage) -> None:
    node = stage.observer.node
    topic = f"{NAME}/joint_trajectory"
    stage.observer.collect(type(message_of(MOTION)), topic)
    assert isinstance(find_controller(node, NAME, lambda: stage.observer.spin(0.01)), ActionController)


def test_the_topic_is_taken_elsewhere(stage: Stage) -> None:
    heard = stage.observer.collect(type(message_of(MOTION)), f"{NAME}/joint_trajectory")
    found = find_controller(stage.observer.node, NAME, lambda: stage.observer.spin(0.01))
    assert isinstance(found, TopicController)
    found.send(MOTION)
    stage.observer.wait_for(lambda: heard, "the trajectory")
    assert heard == [message_of(MOTION)]
