"""Ways to a joint_trajectory_controller: the action where ``control_msgs`` is installed, the topic elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any, Protocol

from builtin_interfaces.msg import Duration
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.trajectories import points_of
from geomid_ros.ros.starting import MATCHING, PATIENCE

_KIND = "trajectory_msgs/msg/JointTrajectory"
NOT_ACCEPTED = "not accepted; check that the controller is active and has these joints"
"""Why a goal came back, as far as a rejection says."""


class Controller(Protocol):
    """Takes trajectories; each replaces the one before it, at once. ``name``: of its topic or action."""

    name: str

    @property
    def ready(self) -> bool:
        """Whether somebody is there to take them."""

    @property
    def problem(self) -> str:
        """Why it does not do what it was sent, if that is known."""

    def send(self, trajectory: Trajectory) -> None:
        """Let it follow a trajectory from now on."""


class TopicController:
    """Publishes on ``<controller>/joint_trajectory``."""

    def __init__(self, node: Node, controller: str) -> None:
        self.name = f"{controller}/joint_trajectory"
        self._publisher = node.create_publisher(JointTrajectory, self.name, 10)

    @property
    def ready(self) -> bool:
        return bool(self._publisher.get_subscription_count() > 0)

    @property
    def problem(self) -> str:
        return "" if self.ready else f"the controller is gone: nothing subscribes to {self.name} any more"

    def send(self, trajectory: Trajectory) -> None:
        self._publisher.publish(message_of(trajectory))


class ActionController:
    """Sends goals to ``<controller>/follow_joint_trajectory``. A goal preempts the one before it."""

    def __init__(self, node: Node, controller: str, action: Any, client: Callable[..., Any]) -> None:
        """``action``: control_msgs' FollowJointTrajectory; ``client``: makes an action client."""
        self.name = action_name(controller)
        self._action = action
        self._client = client(node, action, self.name)
        self._goals = 0
        self._refusal = ""

    @property
    def ready(self) -> bool:
        return bool(self._client.server_is_ready())

    @property
    def problem(self) -> str:
        return self._refusal or ("" if self.ready else f"the controller is gone: nothing serves {self.name} any more")

    def send(self, trajectory: Trajectory) -> None:
        goal = self._action.Goal()
        goal.trajectory = message_of(trajectory)
        self._goals += 1
        number = self._goals
        self._client.send_goal_async(goal).add_done_callback(lambda future: self._on_answer(number, future.result()))

    def _on_answer(self, number: int, handle: Any) -> None:
        if not handle.accepted:
            self._refuse(number, NOT_ACCEPTED)
            return
        handle.get_result_async().add_done_callback(lambda future: self._on_result(number, future.result().result))

    def _on_result(self, number: int, result: Any) -> None:
        if result.error_code != self._action.Result.SUCCESSFUL:
            self._refuse(number, result.error_string or f"error {result.error_code}")

    def _refuse(self, number: int, why: str) -> None:
        if number == self._goals:  # one that was replaced is expected to fail
            self._refusal = f"the controller aborted the motion: {why}"


def message_of(trajectory: Trajectory) -> JointTrajectory:
    """The message, to be followed from when it arrives."""
    message = JointTrajectory(joint_names=list(trajectory.joints))
    for numbers, seconds, nanoseconds in points_of(trajectory):
        time_from_start = Duration(sec=seconds, nanosec=nanoseconds)
        message.points.append(JointTrajectoryPoint(**numbers, time_from_start=time_from_start))
    return message


def find_controller(node: Node, controller: str, look: Callable[[], object]) -> Controller:
    """The controller of this name.

    Args:
        node: to reach it from.
        controller: its name, as ``/joint_trajectory_controller``.
        look: lets a moment pass.

    Raises:
        InputError: nobody is there; it names those who are.
    """
    ways: list[Controller] = [*_action(node, controller), TopicController(node, controller)]
    found: Controller | None = None
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        look()
        first = next((way for way in ways if way.ready), None)
        if first is not None and found is None:
            end = time.monotonic() + MATCHING
        found = first
    if found is not None:
        return found
    others = [
        topic.rpartition("/")[0]
        for topic, kinds in node.get_topic_names_and_types()
        if _KIND in kinds and node.count_subscribers(topic)
    ]
    there = (
        f"available: {', '.join(sorted(others))}" if others else "there is no other; check that it is loaded and active"
    )
    raise InputError(f"--controller {controller}: nothing subscribes to {ways[-1].name}; {there}")


def action_name(controller: str) -> str:
    """The action of a controller."""
    return f"{controller}/follow_joint_trajectory"


def follow_joint_trajectory() -> Any:
    """The action's type; None where ``control_msgs`` is not installed."""
    try:
        return import_module("control_msgs.action").FollowJointTrajectory
    except ImportError:
        return None


def _action(node: Node, controller: str) -> list[Controller]:
    if (action := follow_joint_trajectory()) is None:
        return []
    from rclpy.action.client import ActionClient  # noqa: PLC0415 only with control_msgs

    return [ActionController(node, controller, action, ActionClient)]
