"""Interfaces of a joint_trajectory_controller: its action or topic, and the same action served by the relay."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple, TypeAlias

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from geomid_ros.errors import GeomidError, InputError
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
        def on_result(future: Any) -> None:
            result = future.result().result
            if result.error_code != self._action.Result.SUCCESSFUL:
                self._refuse(number, result.error_string or f"error {result.error_code}")

        if handle.accepted:
            handle.get_result_async().add_done_callback(on_result)
        else:
            self._refuse(number, NOT_ACCEPTED)

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
    topics = (topic for topic, kinds in node.get_topic_names_and_types() if _KIND in kinds)
    others = ", ".join(sorted(topic.rpartition("/")[0] for topic in topics if node.count_subscribers(topic)))
    advice = f"available: {others}" if others else "there is no other; check that it is loaded and active"
    raise InputError(f"--controller {controller}: nothing subscribes to {interfaces[-1].name}; {advice}")


def action_name(controller: str) -> str:
    """Return the name of a controller's action."""
    return f"{controller}/follow_joint_trajectory"


def nothing(acts: str, name: str) -> str:
    """Return the reason why a trajectory does not reach the controller: nothing ``acts`` on this name."""
    return f"nothing {acts} {name}; check that the controller is loaded and active"


def follow_joint_trajectory() -> Any:
    """Return the action's type; None if ``control_msgs`` is not installed."""
    try:
        return import_module("control_msgs.action").FollowJointTrajectory
    except ImportError:
        return None


_IN = "~/follow_joint_trajectory"

NOT_SENT = "a trajectory is not sent on"


class Filled(NamedTuple):
    """``message`` with efforts, and its ``trajectory``; None if it has no points and stops the robot."""

    message: JointTrajectory
    trajectory: Trajectory | None


Fill: TypeAlias = Callable[[JointTrajectory, Callable[[Future[Filled]], None]], None]
"""Adds efforts to a trajectory. The second argument is called later, with the result; it is a GeomidError if the
trajectory must not be sent on."""

_STOP = Filled(JointTrajectory(), None)


class ActionRelay:
    """Serves ``~/follow_joint_trajectory`` for ``CONTROLLER/follow_joint_trajectory``. Feedback, results and cancel
    requests are passed on; tolerances stay as they are.

    A refused goal is aborted, not rejected, as only a result can state why: in its ``error_string``.
    """

    def __init__(
        self,
        node: Node,
        controller: str,
        action: Any,
        fill: Fill,
        follow: Callable[[Filled], None],
        client: Callable[..., Any] = ActionClient,
        server: Callable[..., Any] = ActionServer,
    ) -> None:
        """
        Args:
            node: serves, and reaches the controller.
            controller: its name.
            action: control_msgs' FollowJointTrajectory.
            fill: adds efforts.
            follow: receives the trajectory that the controller follows from now on.
            client: makes an action client.
            server: makes an action server.
        """
        self._action, self._fill, self._follow, self._log = action, fill, follow, node.get_logger()
        self._name = action_name(controller)
        self._client = client(node, action, self._name)
        self._sent: dict[bytes, Any] = {}  # controller's goals, by the ids of the goals here
        self._latest: Any = None  # controller's goal that replaced all earlier ones
        self._outcomes: dict[bytes, tuple[int, Any]] = {}  # status and result of goals that are to end
        callbacks = {"handle_accepted_callback": self._on_goal, "cancel_callback": self._on_cancel}
        server(node, action, _IN, self._result, **callbacks)

    def _on_goal(self, handle: Any) -> None:
        self._fill(handle.request.trajectory, partial(self._on_filled, handle))

    def _on_filled(self, handle: Any, result: Future[Filled]) -> None:
        """Send a goal on, or end it with a reason."""
        request = handle.request
        try:
            filled = result.result()
        except GeomidError as error:
            self._refuse(handle, f"{NOT_SENT}: {error}")
            return
        if not self._client.server_is_ready():
            self._refuse(handle, nothing("serves", self._name))
            return
        request.trajectory = filled.message
        answer = self._client.send_goal_async(request, lambda message: handle.publish_feedback(message.feedback))
        answer.add_done_callback(lambda future: self._on_answer(handle, filled, future.result()))

    def _on_answer(self, handle: Any, filled: Filled, sent: Any) -> None:
        if not sent.accepted:
            self._refuse(handle, NOT_ACCEPTED)
            return
        self._sent[_id(handle)] = self._latest = sent
        self._follow(filled)
        sent.get_result_async().add_done_callback(lambda future: self._on_end(handle, sent, future.result()))
        if handle.is_cancel_requested:  # requested meanwhile
            sent.cancel_goal_async()

    def _on_cancel(self, handle: Any) -> CancelResponse:
        """Ask the controller to cancel a goal; the goal's result shows if it did."""
        if (sent := self._sent.get(_id(handle))) is not None:
            sent.cancel_goal_async()
        return CancelResponse.ACCEPT

    def _on_end(self, handle: Any, sent: Any, ended: Any) -> None:
        if sent is self._latest and ended.status != GoalStatus.STATUS_SUCCEEDED:
            self._follow(_STOP)
        del self._sent[_id(handle)]
        self._end(handle, ended.status, ended.result)

    def _refuse(self, handle: Any, reason: str) -> None:
        self._log.error(reason)
        result = self._action.Result(error_code=self._action.Result.INVALID_GOAL, error_string=reason)
        self._end(handle, GoalStatus.STATUS_ABORTED, result)

    def _end(self, handle: Any, status: int, result: Any) -> None:
        self._outcomes[_id(handle)] = status, result
        handle.execute()

    def _result(self, handle: Any) -> Any:
        """Return the result of a goal that has ended; end it with the controller's status."""
        status, result = self._outcomes.pop(_id(handle))
        if status == GoalStatus.STATUS_SUCCEEDED:
            handle.succeed()
        elif status == GoalStatus.STATUS_CANCELED and handle.is_cancel_requested:
            handle.canceled()
        else:  # also for goals that the controller cancels by itself
            handle.abort()
        return result


def _id(handle: Any) -> bytes:
    return bytes(handle.goal_id.uuid)
