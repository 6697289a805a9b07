"""Action of the relay: sends goals of FollowJointTrajectory on to the controller, with efforts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.errors import GeomidError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.ros.excite.controller import NOT_ACCEPTED, action_name

_IN = "~/follow_joint_trajectory"

NOT_SENT = "a trajectory is not sent on"


class Filled(NamedTuple):
    """``message`` with efforts, and its ``trajectory``; None if it has no points and stops the robot."""

    message: JointTrajectory
    trajectory: Trajectory | None


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
        fill: Callable[[JointTrajectory], Filled],
        follow: Callable[[Filled], None],
        client: Callable[..., Any] = ActionClient,
        server: Callable[..., Any] = ActionServer,
    ) -> None:
        """
        Args:
            node: serves, and reaches the controller.
            controller: its name.
            action: control_msgs' FollowJointTrajectory.
            fill: adds efforts. Raises GeomidError for trajectories that must not be sent on.
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
        server(
            node,
            action,
            _IN,
            self._result,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )

    def _on_goal(self, handle: Any) -> None:
        """Send a goal on, or end it with a reason."""
        request = handle.request
        try:
            filled = self._fill(request.trajectory)
        except GeomidError as error:
            self._refuse(handle, f"{NOT_SENT}: {error}")
            return
        if not self._client.server_is_ready():
            self._refuse(handle, f"nothing serves {self._name}; check that the controller is loaded and active")
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
