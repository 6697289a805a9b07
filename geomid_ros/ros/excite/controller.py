"""Interfaces to a joint_trajectory_controller: its action if ``control_msgs`` is installed, else its topic."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeAlias

from builtin_interfaces.msg import Duration
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.files.trajectories import points_of
from geomid_ros.ros.startup import MATCHING, PATIENCE

_KIND = "trajectory_msgs/msg/JointTrajectory"
NOT_ACCEPTED = "not accepted; check that the controller is active and has these joints"
"""Reason that is reported for a rejected goal, as the rejection itself has none."""


class TopicController:
    """Publishes on ``<controller>/joint_trajectory``; ``name``: of this topic."""

    def __init__(self, node: Node, controller: str) -> None:
        self.name = f"{controller}/joint_trajectory"
        self._publisher = node.create_publisher(JointTrajectory, self.name, 10)

    @property
    def ready(self) -> bool:
        """True if the controller is available."""
        return bool(self._publisher.get_subscription_count() > 0)

    @property
    def problem(self) -> str:
        """Reason why it does not follow the trajectory, if known."""
        return "" if self.ready else f"the controller is gone: nothing subscribes to {self.name} any more"

    def send(self, trajectory: Trajectory) -> None:
        """Let the controller follow a trajectory from now on."""
        self._publisher.publish(message_of(trajectory))


class ActionController:
    """Sends goals to ``<controller>/follow_joint_trajectory``; ``name``: of this action."""

    def __init__(self, node: Node, controller: str, action: Any, client: Callable[..., Any]) -> None:
        """``action``: control_msgs' FollowJointTrajectory; ``client``: makes an action client."""
        self.name = action_name(controller)
        self._action = action
        self._client = client(node, action, self.name)
        self._goals = 0
        self._refusal = ""

    @property
    def ready(self) -> bool:
        """True if the controller is available."""
        return bool(self._client.server_is_ready())

    @property
    def problem(self) -> str:
        """Reason why it does not follow the trajectory, if known."""
        return self._refusal or ("" if self.ready else f"the controller is gone: nothing serves {self.name} any more")

    def send(self, trajectory: Trajectory) -> None:
        """Let the controller follow a trajectory from now on."""
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

    def _refuse(self, number: int, reason: str) -> None:
        if number == self._goals:  # a replaced goal is expected to fail
            self._refusal = f"the controller aborted the motion: {reason}"


TrajectoryController: TypeAlias = TopicController | ActionController
"""Follows trajectories; each that it is sent replaces the previous one at once."""


def message_of(trajectory: Trajectory) -> JointTrajectory:
    """Return the message; the motion starts on arrival."""
    message = JointTrajectory(joint_names=list(trajectory.joints))
    for numbers, seconds, nanoseconds in points_of(trajectory):
        time_from_start = Duration(sec=seconds, nanosec=nanoseconds)
        message.points.append(JointTrajectoryPoint(**numbers, time_from_start=time_from_start))
    return message


def find_controller(node: Node, controller: str, look: Callable[[], object]) -> TrajectoryController:
    """Find the controller of this name.

    Args:
        node: to reach it from.
        controller: its name, as ``/joint_trajectory_controller``.
        look: spins the node for a moment.

    Raises:
        InputError: it is not available; the error names the available ones.
    """
    interfaces: list[TrajectoryController] = [TopicController(node, controller)]
    if (action := follow_joint_trajectory()) is not None:
        from rclpy.action.client import ActionClient  # noqa: PLC0415 only with control_msgs

        interfaces.insert(0, ActionController(node, controller, action, ActionClient))
    ready: TrajectoryController | None = None
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        look()
        first = next((interface for interface in interfaces if interface.ready), None)
        if first is not None and ready is None:
            end = time.monotonic() + MATCHING
        ready = first
    if ready is not None:
        return ready
    others = [
        topic.rpartition("/")[0]
        for topic, kinds in node.get_topic_names_and_types()
        if _KIND in kinds and node.count_subscribers(topic)
    ]
    advice = (
        f"available: {', '.join(sorted(others))}" if others else "there is no other; check that it is loaded and active"
    )
    raise InputError(f"--controller {controller}: nothing subscribes to {interfaces[-1].name}; {advice}")


def action_name(controller: str) -> str:
    """Return the name of a controller's action."""
    return f"{controller}/follow_joint_trajectory"


def follow_joint_trajectory() -> Any:
    """Return the action's type; None if ``control_msgs`` is not installed."""
    try:
        return import_module("control_msgs.action").FollowJointTrajectory
    except ImportError:
        return None
