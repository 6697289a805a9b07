"""The action of a joint_trajectory_controller, on a stub of what ``control_msgs`` and rclpy's client offer: the package
has no wheel. The names are those of control_msgs/action/FollowJointTrajectory."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.action import client as rclpy_client

from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.excite.controller import ActionController, TopicController, find_controller, message_of

from .stage import Stage

NAME = "/arm_controller"
MOTION = Trajectory(("a", "b"), np.array([0.5, 2.25]), np.array([[1, 2], [3, 4]]), np.zeros((2, 2)), np.ones((2, 2)))


class Later:
    """A future that the test fulfils."""

    def __init__(self) -> None:
        self.callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self.callbacks.append(callback)

    def fulfil(self, value: Any) -> None:
        for callback in self.callbacks:
            callback(SimpleNamespace(result=lambda: value))


class FollowJointTrajectory:
    class Goal:
        trajectory: Any = None

    class Result:
        SUCCESSFUL = 0
        PATH_TOLERANCE_VIOLATED = -4


class Client:
    """An action client whose goals the test answers."""

    last: Client

    def __init__(self, _node: Any, action: Any, name: str) -> None:
        assert action is FollowJointTrajectory
        self.name = name
        self.there = True
        self.goals: list[tuple[Any, Later]] = []
        Client.last = self

    def server_is_ready(self) -> bool:
        return self.there

    def send_goal_async(self, goal: Any) -> Later:
        self.goals.append((goal, Later()))
        return self.goals[-1][1]

    def accept(self, number: int) -> Later:
        """Accept a goal; what is returned is its result."""
        result = Later()
        self.goals[number][1].fulfil(SimpleNamespace(accepted=True, get_result_async=lambda: result))
        return result


def ended(code: int, text: str = "") -> Any:
    return SimpleNamespace(result=SimpleNamespace(error_code=code, error_string=text))


@pytest.fixture
def controller() -> ActionController:
    # The stub needs no node.
    return ActionController(None, NAME, FollowJointTrajectory, Client)


def test_a_goal_is_the_trajectory_and_may_succeed(controller: ActionController) -> None:
    controller.send(MOTION)
    assert Client.last.name == "/arm_controller/follow_joint_trajectory"
    assert Client.last.goals[0][0].trajectory == message_of(MOTION)
    Client.last.accept(0).fulfil(ended(FollowJointTrajectory.Result.SUCCESSFUL))
    assert controller.problem == ""


def test_a_goal_that_is_not_accepted_is_told(controller: ActionController) -> None:
    controller.send(MOTION)
    Client.last.goals[0][1].fulfil(SimpleNamespace(accepted=False))
    assert "aborted the motion: not accepted" in controller.problem


def test_a_goal_that_is_aborted_is_told(controller: ActionController) -> None:
    controller.send(MOTION)
    Client.last.accept(0).fulfil(ended(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "path tolerance"))
    assert controller.problem == "the controller aborted the motion: path tolerance"


def test_a_goal_that_was_replaced_may_fail(controller: ActionController) -> None:
    controller.send(MOTION)
    result = Client.last.accept(0)
    controller.send(MOTION)
    result.fulfil(ended(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "preempted"))
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
